//! Counts what the core's stages cost, compares them with other people's, and runs the whole board.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, Parser, Subcommand};
use cycles::host::{Inputs, Whole};
use cycles::kinds::KINDS;
use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::condition::Levels;
use taxel::wire::message::Command;
use taxel_files::trace::TraceReader;

use taxel_emulator::board::cpu::{Board, End};
use taxel_emulator::board::finger::{Finger, Pace, in_12_bits};
use taxel_emulator::board::host::Host;
use taxel_emulator::board::model::Model;
use taxel_emulator::board::script::Session;
use taxel_emulator::board::server::Server;
use taxel_emulator::board::{capture, diagram, time, timing};
use taxel_emulator::profile::Profiler;
use taxel_emulator::{bench, peers, report};

/// A Cortex-M4F machine: exact instructions, modelled cycles
#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// What every stage of the core costs
    Cycles(Cycles),
    /// Runs the board's image
    Board(RunBoard),
    /// Which functions of the board's image the cycles go to while it streams 1000 frames a second
    Profile(Profile),
    /// What the same net costs in other people's libraries
    Peers(Peers),
    /// Runs it with its USB behind a TCP port
    Serve(Serve),
}

/// The finger that stages and nets work on.
#[derive(Args)]
struct Seen {
    /// Calibration of the finger that the scans are of
    #[arg(long)]
    calibration: PathBuf,
    /// Trace CSV with a `contact` column
    #[arg(long)]
    scans: PathBuf,
    /// Folder of a finger as it is shipped: its calibration, and a trace for each kind of scene
    #[arg(long)]
    whole: PathBuf,
}

#[derive(Args)]
struct Peers {
    /// The bench image, `boards/cycles`, for the core's own net
    image: PathBuf,
    #[command(flatten)]
    seen: Seen,
    /// An image of peers/peers.c, and what it was built with, as in `gcc 12.2 -O3=peers.elf`
    #[arg(long = "peer", value_name = "WITH=ELF", required = true)]
    peers: Vec<String>,
    /// A peer that could not be built, and why
    #[arg(long)]
    missing: Vec<String>,
    /// Where the table goes
    #[arg(long)]
    csv: PathBuf,
}

#[derive(Args)]
struct Cycles {
    /// The bench image, `boards/cycles`
    image: PathBuf,
    #[command(flatten)]
    seen: Seen,
    /// Only stages whose name contains this
    #[arg(long, default_value = "")]
    filter: String,
    /// Also writes the table here
    #[arg(long)]
    csv: Option<PathBuf>,
    /// Shows which functions the cycles go to
    #[arg(long)]
    profile: bool,
    /// Fails where a stage has become dearer than in this CSV
    #[arg(long)]
    against: Option<PathBuf>,
}

#[derive(Args)]
struct RunBoard {
    /// The firmware, `cargo xtask firmware BOARD`
    image: PathBuf,
    /// The board that it is for
    #[arg(long, value_enum, default_value_t = Model::G431)]
    board: Model,
    /// Virtual seconds
    #[arg(long, default_value_t = 1.0)]
    seconds: f64,
    /// Writes what went over the USB here, as Linux's usbmon would
    #[arg(long)]
    pcap: Option<PathBuf>,
    /// Writes what happens on the scan's pins here, as CSV
    #[arg(long)]
    timing: Option<PathBuf>,
    /// The same as a value change dump, for a viewer of waveforms
    #[arg(long)]
    vcd: Option<PathBuf>,
    /// Draws the diagram of the board's page from it, as SVG
    #[arg(long)]
    diagram: Option<PathBuf>,
}

#[derive(Args)]
struct Profile {
    /// The firmware, `boards/stm32g431`
    image: PathBuf,
    #[command(flatten)]
    seen: Seen,
    /// Virtual seconds
    #[arg(long, default_value_t = 1.0)]
    seconds: f64,
}

#[derive(Args)]
struct Serve {
    /// The firmware, `cargo xtask firmware BOARD`
    image: PathBuf,
    /// The board that it is for
    #[arg(long, value_enum, default_value_t = Model::G431)]
    board: Model,
    /// What the finger sees, a trace CSV; again from its beginning when it is over
    #[arg(long)]
    trace: PathBuf,
    /// A scan of the trace for each of the board's, from the first whenever it begins to scan and to the last,
    /// which stays; time waits for the client
    #[arg(long)]
    replay: bool,
    /// Where to listen; port 0 is any that is free
    #[arg(long, default_value = "127.0.0.1:0")]
    listen: String,
    /// Ends when standard input closes, as it does with the program that started this one
    #[arg(long)]
    attached: bool,
}

/// Says on the first line where the board listens, then serves it until it is ended.
fn serve(arguments: &Serve) -> Result<()> {
    if arguments.attached {
        std::thread::spawn(|| {
            // However reading ends, nobody holds the other end any more.
            let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
            std::process::exit(0);
        });
    }
    let samples = TraceReader::open(&arguments.trace)?.collect::<Result<Vec<_>, _>>()?;
    let [first, .., last] = samples.as_slice() else {
        bail!("{}: needs two scans at least", arguments.trace.display());
    };
    let pace = if arguments.replay {
        Pace::Replay
    } else {
        let span = last.scan.time.0.saturating_sub(first.scan.time.0);
        let each = span as f64 / (samples.len() - 1) as f64;
        Pace::Timed((each * (time::HZ / 1_000_000) as f64).round() as time::Tick)
    };
    let scene = samples.iter().map(|sample| in_12_bits(sample.scan.codes)).collect();
    let finger = Finger::new(scene, pace);
    let board = Board::new(arguments.board, &bytes(&arguments.image)?, finger, Host::new(false))?;
    let mut server = Server::new(board, &arguments.listen, arguments.replay)?;
    println!("{}", server.greeting()?);
    server.serve()
}

/// Lets the board run with nobody at its port; says how fast that was.
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
            diagram::svg(&moments).context("too short to see a whole frame; --seconds 1")?;
        write(path, drawn.as_bytes())?;
    }
    Ok(())
}

/// Calibrated, with every scan of the trace in turn, an ordinary client at the port.
fn profile_board(arguments: &Profile) -> Result<()> {
    let (_, record) = recorded(&arguments.seen.calibration)?;
    let scans = TraceReader::open(&arguments.seen.scans)?;
    let scans = scans.map(|sample| Ok(in_12_bits(sample?.scan.codes)));
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
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("taxel-emulator: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// What the stages' inputs are read into.
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

/// A calibration and its record.
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
        all.extend(peers::run(&bytes(Path::new(elf))?, with, &net, &signals)?);
    }
    for peer in &all {
        let (cycles, instructions) = (peer.worst.cycles, peer.worst.instructions);
        println!(
            "{:<60} {:.1e}  {}-{} cycles  {instructions} instructions",
            peer.name, peer.max_error, cycles.low, cycles.high
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

/// The scans of a trace in postcard: without contact, and in contact.
fn scans(path: &Path) -> Result<[Vec<u8>; 2]> {
    let mut parts = [Vec::new(), Vec::new()];
    for sample in TraceReader::open(path)? {
        let sample = sample?;
        let Some(contact) = sample.truth.contact else {
            bail!("{}: needs a column `contact`", path.display());
        };
        parts[usize::from(contact)].extend(postcard::to_stdvec(&sample.scan)?);
    }
    ensure!(
        parts.iter().all(|part| !part.is_empty()),
        "{}: needs scans with contact and scans without",
        path.display()
    );
    Ok(parts)
}
