//! Command that counts the core's stages, compares them with other libraries, and runs a whole
//! board.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, Parser, Subcommand};
use cycles::host::{Inputs, Whole};
use cycles::kinds::KINDS;
use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::condition::Levels;
use taxel::units::FullScale;
use taxel::wire::message::Command;
use taxel_files::trace::TraceReader;

use taxel_emulator::board::cpu::{Board, End};
use taxel_emulator::board::finger::{Finger, Pace};
use taxel_emulator::board::host::Host;
use taxel_emulator::board::model::Model;
use taxel_emulator::board::script::Session;
use taxel_emulator::board::server::Server;
use taxel_emulator::board::{capture, diagram, time, timing};
use taxel_emulator::clock::Count;
use taxel_emulator::faults::table::Row;
use taxel_emulator::faults::{self, Campaign};
use taxel_emulator::profile::Profiler;
use taxel_emulator::{bench, peers, report};

/// Cortex-M4F machine with exact instructions and modelled cycles
#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Counts instructions and cycles of every stage of the core
    Cycles(Cycles),
    /// Runs a board's image for a time and reports the emulator's speed
    Board(RunBoard),
    /// Lists the functions of the board's image that take the cycles at 1000 frames a second
    Profile(Profile),
    /// Counts the cost of the same net in other libraries
    Peers(Peers),
    /// Runs a board's image with its USB port on a TCP port
    Serve(Serve),
    /// Inverts each bit of each configuration register that the image writes, and lists what passes
    Faults(Faults),
}

/// Calibration and scans that stages and nets work on.
#[derive(Args)]
struct Seen {
    /// Calibration (TOML) of the finger in the scans
    #[arg(long)]
    calibration: PathBuf,
    /// Trace CSV with a `contact` column
    #[arg(long)]
    scans: PathBuf,
    /// Folder of a finger as shipped: `finger.cal.toml` and one trace for each kind of scene
    #[arg(long)]
    whole: PathBuf,
}

#[derive(Args)]
struct Peers {
    /// Bench image (`boards/cycles`), for the core's own net
    image: PathBuf,
    #[command(flatten)]
    seen: Seen,
    /// Image of peers/peers.c with its compiler and options, as in `gcc 12.2 -O3=peers.elf`
    #[arg(long = "peer", value_name = "WITH=ELF", required = true)]
    peers: Vec<String>,
    /// Library that could not be built, and the reason, as in `NAME: REASON`
    #[arg(long)]
    missing: Vec<String>,
    /// CSV file to write the table to
    #[arg(long)]
    csv: PathBuf,
}

#[derive(Args)]
struct Cycles {
    /// Bench image (`boards/cycles`)
    image: PathBuf,
    #[command(flatten)]
    seen: Seen,
    /// Only stages whose name contains this
    #[arg(long, default_value = "")]
    filter: String,
    /// CSV file to write the table to as well
    #[arg(long)]
    csv: Option<PathBuf>,
    /// Lists the functions that take the cycles of each stage
    #[arg(long)]
    profile: bool,
    /// Fails if a stage executes more instructions than in this CSV, by more than a tenth
    #[arg(long)]
    against: Option<PathBuf>,
}

#[derive(Args)]
struct RunBoard {
    /// Firmware image, from `cargo xtask firmware BOARD`
    image: PathBuf,
    /// Board of the image
    #[arg(long, value_enum, default_value_t = Model::G431)]
    board: Model,
    /// Virtual seconds
    #[arg(long, default_value_t = 1.0)]
    seconds: f64,
    /// File to write the USB traffic to, in the pcap format of Linux's usbmon
    #[arg(long)]
    pcap: Option<PathBuf>,
    /// CSV file to write the scan's pin events to
    #[arg(long)]
    timing: Option<PathBuf>,
    /// File to write the pin events to as a value change dump, for a waveform viewer
    #[arg(long)]
    vcd: Option<PathBuf>,
    /// SVG file to draw the timing diagram of the board's page to
    #[arg(long)]
    diagram: Option<PathBuf>,
}

#[derive(Args)]
struct Profile {
    /// Firmware image of `boards/stm32g431`
    image: PathBuf,
    #[command(flatten)]
    seen: Seen,
    /// Virtual seconds
    #[arg(long, default_value_t = 1.0)]
    seconds: f64,
}

#[derive(Args)]
struct Faults {
    /// Firmware image, from `cargo xtask firmware BOARD`
    image: PathBuf,
    /// Board of the image
    #[arg(long, value_enum, default_value_t = Model::G431)]
    board: Model,
    /// Trace CSV that the scans are taken from
    #[arg(long)]
    scans: PathBuf,
    /// Only registers whose name contains this
    #[arg(long, default_value = "")]
    filter: String,
    /// CSV file to write the verdicts to
    #[arg(long)]
    csv: Option<PathBuf>,
    /// Board's page whose table of survivors is written
    #[arg(long)]
    page: Option<PathBuf>,
}

/// Injects every fault, and writes the verdicts and the board page's table.
fn inject(arguments: &Faults) -> Result<()> {
    let samples = TraceReader::open(&arguments.scans)?.collect::<Result<Vec<_>, _>>()?;
    let scene =
        samples.iter().map(|sample| sample.scan.codes.rescaled(FullScale::BITS_12)).collect();
    let campaign = Campaign::new(arguments.board, bytes(&arguments.image)?, scene)?;
    let mut rows = Vec::new();
    for register in campaign.registers.iter().filter(|r| r.name.contains(&arguments.filter)) {
        let row = Row::of(&campaign, register);
        println!("{}", row.line());
        rows.push(row);
    }
    let [killed, refused, unnoticed] = faults::table::score(&rows);
    println!("faults: {killed} killed, {refused} refused, {unnoticed} unnoticed");
    if let Some(path) = &arguments.csv {
        write(path, faults::table::csv(&rows).as_bytes())?;
    }
    if let Some(path) = &arguments.page {
        let page = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
        let page = faults::table::drawn(&page, arguments.board, &rows);
        let page = page.with_context(|| format!("{}: no part `faults`", path.display()))?;
        write(path, page.as_bytes())?;
    }
    Ok(())
}

#[derive(Args)]
struct Serve {
    /// Firmware image, from `cargo xtask firmware BOARD`
    image: PathBuf,
    /// Board of the image
    #[arg(long, value_enum, default_value_t = Model::G431)]
    board: Model,
    /// Trace CSV that the scans are taken from; starts again at its end
    #[arg(long)]
    trace: PathBuf,
    /// Takes one scan of the trace for each scan of the board, from the first whenever scanning
    /// starts
    ///
    /// The last scan of the trace repeats. Virtual time waits for the client: it passes from each
    /// request to its reply, and without end once the client has closed its sending side.
    #[arg(long)]
    replay: bool,
    /// Address to listen on; port 0 takes any free port
    #[arg(long, default_value = "127.0.0.1:0")]
    listen: String,
    /// Ends when standard input closes, that is when the parent program ends
    #[arg(long)]
    attached: bool,
}

/// Prints the address the board listens on as its first line, then serves it without end.
fn serve(arguments: &Serve) -> Result<()> {
    if arguments.attached {
        std::thread::spawn(|| {
            // Whether reading ends or fails, the parent program has closed the pipe.
            let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
            std::process::exit(0);
        });
    }
    let samples = TraceReader::open(&arguments.trace)?.collect::<Result<Vec<_>, _>>()?;
    let [first, .., last] = samples.as_slice() else {
        bail!(
            "{}: has fewer than two scans; a trace to serve needs two",
            arguments.trace.display()
        );
    };
    let pace = if arguments.replay {
        Pace::Replay
    } else {
        let span = last.scan.time.0.saturating_sub(first.scan.time.0);
        let each = span as f64 / (samples.len() - 1) as f64;
        Pace::Timed((each * (time::HZ / 1_000_000) as f64).round() as time::Tick)
    };
    let scene =
        samples.iter().map(|sample| sample.scan.codes.rescaled(FullScale::BITS_12)).collect();
    let finger = Finger::new(scene, pace);
    let board = Board::new(arguments.board, &bytes(&arguments.image)?, finger, Host::new(false))?;
    let mut server = Server::new(board, &arguments.listen)?;
    println!("{}", server.greeting()?);
    if arguments.replay { server.replay() } else { server.serve() }
}

/// Runs the board with its port closed, and prints the emulator's speed.
fn run_board(arguments: &RunBoard) -> Result<()> {
    let elf = bytes(&arguments.image)?;
    let host = Host::new(arguments.pcap.is_some());
    let mut board = Board::new(arguments.board, &elf, Finger::new(Vec::new(), Pace::Scans), host)?;
    let timed = [&arguments.timing, &arguments.vcd, &arguments.diagram];
    board.finger().timing = timed.iter().any(|path| path.is_some()).then(Vec::new);
    let start = Instant::now();
    let time = (arguments.seconds * time::HZ as f64) as time::Tick;
    match board.run(time)? {
        End::Time => {}
        end => bail!("{:.6} s: the board ended: {end:?}", time::seconds(board.now())),
    }
    let real = start.elapsed().as_secs_f64();
    println!(
        "{:.3} virtual seconds in {real:.3}: {:.0} virtual µs and {:.1} million instructions a real second; \
         {} frames scanned",
        time::seconds(board.now()),
        time::seconds(board.now()) * 1e6 / real,
        board.instructions() as f64 / real / 1e6,
        board.finger().seen.len()
    );
    for (number, text) in &board.host().descriptors.strings {
        println!("USB string {number}: {text}");
    }
    if let (Some(path), Some(urbs)) = (&arguments.pcap, &board.host().capture) {
        write(path, &capture::pcap(urbs))?;
    }
    let moments = board.finger().timing.take().unwrap_or_default();
    if let Some(path) = &arguments.timing {
        write(path, timing::csv(&moments).as_bytes())?;
    }
    if let (Some(path), Some(wiring)) = (&arguments.vcd, board.finger().wiring()) {
        let mut dump = Vec::new();
        timing::vcd(&moments, wiring, &mut dump)?;
        write(path, &dump)?;
    }
    if let Some(path) = &arguments.diagram {
        let drawn =
            diagram::svg(&moments).context("no whole frame in that time; use --seconds 1")?;
        write(path, drawn.as_bytes())?;
    }
    Ok(())
}

/// Profiles the calibrated product while a client streams every scan of the trace.
fn profile_board(arguments: &Profile) -> Result<()> {
    let (_, record) = recorded(&arguments.seen.calibration)?;
    let scans = TraceReader::open(&arguments.seen.scans)?;
    let scans = scans.map(|sample| Ok(sample?.scan.codes.rescaled(FullScale::BITS_12)));
    let finger = Finger::new(scans.collect::<Result<_>>()?, Pace::Scans);
    let board = Board::new(Model::G431, &bytes(&arguments.image)?, finger, Host::new(false))?;
    let profiler = Profiler::new(&arguments.image)?;
    let mut session = Session::open(board)?;
    session.upload(&record)?;
    session.ask(Command::Stream(true))?;
    session.board.clock().count_all();
    session.board.finger().seen.clear();
    session.run((arguments.seconds * time::HZ as f64) as time::Tick)?;
    let scans = session.board.finger().seen.len();
    let name = format!("{}: a scan, and a quarter of a frame", arguments.image.display());
    report::profile(&name, &profiler.shares(scans, session.board.clock()));
    Ok(())
}

fn main() -> ExitCode {
    let done = match Arguments::parse().task {
        Task::Cycles(cycles) => count(&cycles),
        Task::Board(arguments) => run_board(&arguments),
        Task::Profile(arguments) => profile_board(&arguments),
        Task::Peers(peers) => compare_with(&peers),
        Task::Serve(arguments) => serve(&arguments),
        Task::Faults(arguments) => inject(&arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("taxel-emulator: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Inputs of the stages, read from the files.
struct Read {
    calibration: Calibration,
    record: Vec<u8>,
    free: Vec<u8>,
    touched: Vec<u8>,
    whole: Vec<u8>,
    runs: [Vec<u8>; KINDS.len()],
}

impl Seen {
    fn read(&self) -> Result<Read> {
        let (calibration, record) = recorded(&self.calibration)?;
        let [free, touched] = scans(&self.scans)?;
        let (_, whole) = recorded(&self.whole.join("finger.cal.toml"))?;
        let mut runs = KINDS.map(|_| Vec::new());
        for (run, kind) in runs.iter_mut().zip(KINDS) {
            let path = self.whole.join(kind.name.replace(' ', "-")).with_extension("csv");
            for sample in TraceReader::open(&path)? {
                run.extend(postcard::to_stdvec(&sample?.scan)?);
            }
        }
        Ok(Read { calibration, record, free, touched, whole, runs })
    }
}

impl Read {
    fn inputs(&self) -> Inputs<'_> {
        let Self { record, free, touched, whole, runs, .. } = self;
        let runs = runs.each_ref().map(Vec::as_slice);
        Inputs { record, free, touched, whole: Whole { record: whole, runs } }
    }
}

/// Calibration in the file at `path`, and its record.
fn recorded(path: &Path) -> Result<(Calibration, Vec<u8>)> {
    let calibration = taxel_files::calibration::read(path)?;
    let mut record = [0; MAX_BYTES];
    match calibration.to_bytes(&mut record) {
        Ok(record) => Ok((calibration, record.to_vec())),
        Err(error) => bail!("{}: {error:?}", path.display()),
    }
}

fn compare_with(arguments: &Peers) -> Result<()> {
    let read = arguments.seen.read()?;
    let inputs = read.inputs();
    let (net, bias) = (cycles::papers_net(), read.calibration.bias());
    let signals: Vec<_> = inputs
        .touched()
        .filter_map(|scan| bias.apply(&Levels::read(&scan.codes), None).taxels)
        .collect();
    let stages = bench::run(&bytes(&arguments.image)?, &inputs, |_, _| {})?;
    let own = |name: &str| {
        let stage = stages.iter().find(|stage| stage.name == name);
        stage.with_context(|| format!("the image has no {name}"))
    };
    let q15 = cycles::papers_net_quantised().context("the net does not fit into 16 bits")?;
    let mut all = vec![
        peers::own("taxel", own("net 16-16-3")?, &net, &signals, |c| net.forces(c)),
        peers::own("taxel q15", own("q15 net 16-16-3")?, &net, &signals, |c| q15.forces(c)),
    ];
    for peer in &arguments.peers {
        let (with, elf) = peer.rsplit_once('=').context("--peer: expected WITH=ELF")?;
        let elf = bytes(Path::new(elf))?;
        all.extend(peers::run(&elf, with, (&net, q15.signal), &signals)?);
    }
    for peer in &all {
        let Count { cycles, bounds, instructions, .. } = peer.worst;
        println!(
            "{:<80} {:.1e}  {}-{} cycles, bounds {}-{}  {instructions} instructions",
            peer.name, peer.max_error, cycles.low, cycles.high, bounds.low, bounds.high
        );
    }
    let table = peers::csv(&peers::best(all), &arguments.missing);
    std::fs::write(&arguments.csv, table)
        .with_context(|| format!("{}: not written", arguments.csv.display()))
}

fn count(arguments: &Cycles) -> Result<()> {
    let elf = bytes(&arguments.image)?;
    let read = arguments.seen.read()?;
    let inputs = read.inputs();
    let profiler = arguments.profile.then(|| Profiler::new(&arguments.image)).transpose()?;
    let wanted = |name: &str| name.contains(&arguments.filter);
    let stages = bench::run(&elf, &inputs, |stage, clock| {
        if let Some(profiler) = &profiler
            && wanted(&stage.name)
        {
            report::profile(&stage.name, &profiler.shares(stage.calls.len(), clock));
        }
    })?;
    let stages: Vec<_> = stages.into_iter().filter(|stage| wanted(&stage.name)).collect();
    ensure!(!stages.is_empty(), "--filter {}: no stage has that in its name", arguments.filter);
    report::table(&stages);
    if let Some(path) = &arguments.csv {
        std::fs::write(path, report::csv(&stages))
            .with_context(|| format!("{}: not written", path.display()))?;
    }
    match &arguments.against {
        Some(path) => report::compare(path, &stages),
        None => Ok(()),
    }
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("{}: not written", path.display()))
}

fn bytes(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| path.display().to_string())
}

/// Scans of a trace in postcard: without contact, and in contact.
fn scans(path: &Path) -> Result<[Vec<u8>; 2]> {
    let mut parts = [Vec::new(), Vec::new()];
    for sample in TraceReader::open(path)? {
        let sample = sample?;
        let Some(contact) = sample.truth.contact else {
            bail!("{}: has no column `contact`; record the trace with its truth", path.display());
        };
        parts[usize::from(contact)].extend(postcard::to_stdvec(&sample.scan)?);
    }
    ensure!(
        parts.iter().all(|part| !part.is_empty()),
        "{}: lacks scans with contact or scans without; both are needed",
        path.display()
    );
    Ok(parts)
}
