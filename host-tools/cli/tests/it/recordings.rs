//! Tests of recording: three file formats at once, equal numbers in each, and failures.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::Child;
use std::time::Duration;

use crate::common::{In, rows_so_far, until};
use taxel_files::frames::Cell;
use taxel_files::recording::Recording;
use taxel_files::stretch::Stretch;

fn rows(path: &Path) -> Vec<Vec<Cell>> {
    Recording::open(path).unwrap().map(Result::unwrap).collect()
}

fn whole(recording: &Recording, row: &[Cell], name: &str) -> u64 {
    match row[recording.position(name).unwrap()] {
        Cell::Whole(value) => value,
        other => panic!("{name}: {other:?}"),
    }
}

#[test]
fn three_formats_of_one_stream_are_equal() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let out = ["a.mcap", "a.parquet", "a.csv"];
    let files = out.iter().flat_map(|name| ["--out", name]);
    let args = ["record", "--port", "sim:press", "--duration", "1", "--fields", "all"];
    let said = taxel.succeeds(&args.into_iter().chain(files).collect::<Vec<_>>());
    assert!(said.starts_with("a.mcap, a.parquet, a.csv: 1000 frames, 0 lost"), "{said}");

    let [mcap, parquet, csv] = out.map(|name| folder.path().join(name));
    let first = rows(&mcap);
    assert_eq!(first.len(), 1000);
    assert_eq!(rows(&parquet), first);
    assert_eq!(rows(&csv).len(), 1000);
    let recording = Recording::open(&mcap).unwrap();
    let facts = &recording.header.facts;
    for (name, value) in [("board", "virtual"), ("serial", "press"), ("full_scale", "65535")] {
        assert_eq!(facts[name], value);
        assert_eq!(Recording::open(&csv).unwrap().header.facts[name], value);
    }
    assert_eq!(facts["calibration_crc"].len(), 8);
    assert!(recording.header.calibration.as_ref().unwrap().contains(&facts["calibration_crc"]));
    // Host and device time advance alike.
    let span = |name| {
        let at = |row: &Vec<Cell>| whole(&recording, row, name);
        (at(&first[999]) - at(&first[0])) as f64 * 1e-6
    };
    assert!((span("t_us") - 0.999).abs() < 0.002, "{}", span("t_us"));
    assert!((span("host_us") - span("t_us")).abs() < 0.5, "{}", span("host_us"));
}

#[test]
fn recording_plays_and_recomputes_same_frames() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let record = |port: &str, out: &str| {
        taxel.succeeds(&[
            "record",
            "--port",
            port,
            "--duration",
            "1",
            "--fields",
            "all",
            "--out",
            out,
        ])
    };
    record("sim:press", "a.mcap");
    taxel.succeeds(&["replay", "a.mcap", "--fields", "all", "--out", "again.mcap"]);
    let (recorded, again) = (folder.path().join("a.mcap"), folder.path().join("again.mcap"));
    let recording = Recording::open(&recorded).unwrap();
    let force = recording.position("fz_n").unwrap();
    let same =
        rows(&recorded).iter().zip(rows(&again)).filter(|(a, b)| a[force] == b[force]).count();
    // The finger's contact gate had history before the recording; the replay's starts without.
    assert!(same > 900, "{same}");
    // The recording includes the calibration.
    let info = taxel.succeeds(&["info", "--port", "file:a.mcap", "--json"]);
    let info: serde_json::Value = serde_json::from_str(&info).unwrap();
    assert_eq!(info["calibration"]["crc"], recording.header.facts["calibration_crc"].as_str());
    for (fact, value) in [("serial", "press"), ("board", "virtual")] {
        assert_eq!(info[fact], value);
    }
    // A playback's counters are not the finger's.
    assert!(info["counters"].is_null() && info["started_after"].is_null(), "{info}");
    let text = taxel.succeeds(&["info", "--port", "file:a.mcap"]);
    assert!(!text.contains("counted") && !text.contains("started"), "{text}");
    taxel.succeeds(&["export", "a.mcap", "--out", "a.csv"]);
    record("file:a.csv", "b.csv");
    assert!(rows(&folder.path().join("b.csv")).len() > 500);
}

/// Computes all numbers of a finger with changed settings again from its codes. They are equal to
/// the bit, except for effects of history before the first code. The filter's beginning fades in
/// f32 to a rounding, which may stay while a finger rests. The estimated friction does not fade, so
/// that values based on it are left out here.
#[test]
fn replay_uses_recorded_settings() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let (mut finger, port) = served(&taxel, &["--port", "sim:press", "--tcp", "127.0.0.1:0"]);
    taxel.succeeds(&["set", "--port", &port, "--filter", "20", "--point", "argmin"]);
    let bias = ["bias", "--port", &port, "take", "--scans", "50", "--json"];
    // While unloaded, which is nearly half of the two seconds.
    let untouched =
        |ran: crate::common::Ran| ran.code == Some(0) && ran.out.contains("\"in_contact\":false");
    assert!((0..200).any(|_| untouched(taxel.taxel(&bias))));
    let record = ["record", "--port", &port, "--duration", "4", "--fields", "all"];
    taxel.succeeds(&[record.as_slice(), &["--out", "a.mcap", "--out", "a.csv"]].concat());
    finger.kill().unwrap();
    finger.wait().unwrap();

    let recording = Recording::open(&folder.path().join("a.mcap")).unwrap();
    let facts = &recording.header.facts;
    assert_eq!((&*facts["filter_hz"], &*facts["point"]), ("20", "argmin"));
    assert_eq!(facts["bias_matrix"].split(' ').count(), 17);
    let (time, host) =
        (recording.position("t_us").unwrap(), recording.position("host_us").unwrap());
    // Compared by device time, without sequence number and host columns.
    let remembered =
        ["slip_margin", "friction", "grip_n"].map(|name| recording.position(name).unwrap());
    let misfit = recording.position("misfit").unwrap();
    let of = |name: &str, from: u64| {
        let rows = rows(&folder.path().join(name)).into_iter();
        let kept = |row: &Vec<Cell>| {
            let kept = (2..host).filter(|i| !remembered.contains(i));
            kept.map(|i| (if i == misfit { SMALL_OF_LARGE } else { ROUNDINGS }, row[i])).collect()
        };
        let rows = rows.map(|row| (row[time], kept(&row)));
        rows.filter(|(time, _)| matches!(time, Cell::Whole(t) if *t >= from)).collect::<Vec<_>>()
    };
    let said = of("a.mcap", 0);
    let Cell::Whole(first) = said[0].0 else { panic!("{:?}", said[0].0) };
    let settled = of("a.mcap", first + 1_000_000);
    assert!(settled.len() > 2900, "{}", settled.len());

    taxel.succeeds(&["replay", "a.mcap", "--fields", "all", "--out", "again.mcap"]);
    assert_alike(&of("again.mcap", first + 1_000_000), &settled);
    taxel.succeeds(&["record", "--port", "file:a.mcap", "--out", "played.mcap"]);
    let played = of("played.mcap", first + 1_000_000);
    // The first scans pass during the client's handshake.
    let missed = settled.len() - played.len();
    assert!(missed < 2000, "{missed}");
    assert_alike(&played, &settled[missed..]);
    // Both new files keep the facts about the finger.
    for name in ["again.mcap", "played.mcap"] {
        let again = Recording::open(&folder.path().join(name)).unwrap();
        for fact in facts.keys().filter(|fact| !["port", "started"].contains(&fact.as_str())) {
            assert_eq!(again.header.facts[fact], facts[fact], "{name}: {fact}");
        }
        assert_eq!(again.header.calibration, recording.header.calibration);
    }
    let header = Recording::open(&folder.path().join("again.mcap")).unwrap().header;
    assert_eq!(header.facts["replayed"], "a.mcap");
    // CSV has the bias too, though not the calibration.
    assert_eq!(Recording::open(&folder.path().join("a.csv")).unwrap().header.bias(), header.bias());
    let error = taxel.fails(1, &["replay", "a.mcap", "--on", "stm32g431", "--out", "b.csv"]);
    assert!(error.contains("which a board cannot be given"), "{error}");

    // A recording of the older format, which states only that a bias was taken.
    let text = std::fs::read_to_string(folder.path().join("a.csv")).unwrap();
    let old: Vec<_> = text.lines().filter(|line| !line.starts_with("# bias_")).collect();
    std::fs::write(folder.path().join("old.csv"), old.join("\n") + "\n").unwrap();
    let ran = taxel.taxel(&["info", "--port", "file:old.csv"]);
    assert!(ran.err.starts_with("old.csv: the finger had a bias taken on command"), "{}", ran.err);
}

/// Row: its time, and each cell with its tolerance.
type Timed = (Cell, Vec<(f32, Cell)>);

/// Asserts equal times, flags and reasons, and numbers equal within a few roundings of f32.
fn assert_alike(found: &[Timed], expected: &[Timed]) {
    assert_eq!(found.len(), expected.len());
    for ((time, found), (expected_time, expected)) in found.iter().zip(expected) {
        assert_eq!((time, found.len()), (expected_time, expected.len()));
        for (i, ((_, found), (bound, expected))) in found.iter().zip(expected).enumerate() {
            match (found, expected) {
                (Cell::Real(a), Cell::Real(b)) => {
                    assert!((a - b).abs() <= bound * b.abs().max(1.0), "{time:?}, {i}: {a} {b}");
                }
                (a, b) => assert_eq!(a, b, "{time:?}, {i}"),
            }
        }
    }
}
/// Tolerance of a filter's roundings in estimates, as a fraction.
const ROUNDINGS: f32 = 1e-6;
/// Tolerance of the model's residuals, small differences of large numbers.
const SMALL_OF_LARGE: f32 = 1e-4;

/// Starts a virtual finger in its own process; returns the process and its port.
fn served(taxel: &In, args: &[&str]) -> (Child, String) {
    let mut finger = taxel.command(&[&["serve"], args].concat()).spawn().unwrap();
    let mut said = String::new();
    BufReader::new(finger.stdout.take().unwrap()).read_line(&mut said).unwrap();
    assert!(said.starts_with("tcp:"), "{said}");
    (finger, said.trim().to_owned())
}

#[test]
fn recording_without_codes_plays_its_frames() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let record = |port: &str, more: &[&str], out: &str| {
        let args = ["record", "--port", port, "--out", out];
        taxel.succeeds(&[args.as_slice(), more].concat())
    };
    record("sim:press", &["--duration", "1", "--fields", "force,point,slip"], "a.mcap");
    let said = record("file:a.mcap", &[], "again.mcap");
    assert!(said.starts_with("again.mcap: 1000 frames, 0 lost"), "{said}");
    let (a, again) = (folder.path().join("a.mcap"), folder.path().join("again.mcap"));
    let (recording, played) = (Recording::open(&a).unwrap(), Recording::open(&again).unwrap());
    let finger = recording.position("host_us").unwrap();
    let said =
        |path: &Path| rows(path).iter().map(|row| row[..finger].to_vec()).collect::<Vec<_>>();
    assert_eq!(said(&a), said(&again));
    for fact in ["serial", "rate_hz", "fields", "calibration_crc"] {
        assert_eq!(recording.header.facts[fact], played.header.facts[fact], "{fact}");
    }
    assert_eq!(recording.header.calibration, played.header.calibration);
    let error = taxel.fails(1, &["bias", "--port", "file:a.mcap", "take"]);
    assert!(error.contains("this board cannot do that"), "{error}");
}

/// Scene of presses as `calibrate record` asks for them, on a finger without a calibration.
fn asked_for() -> String {
    let mut scene = String::from(
        "effects = ['noise']\n[scan]\nrate_hz = 500\nduration_s = 30\n[device]\nbits = 16\n\
         [indenter]\nradius_mm = 6\n[friction]\nmu = 0.8\n",
    );
    // The finger is still for the first seconds, in which the command connects.
    let mut at = 4.0;
    let mut press = |[x, y]: [f64; 2], fz: f64, [fx, fy]: [f64; 2], hold: f64| {
        scene += &format!(
            "[[press]]\nat_s = {at:.2}\nx_mm = {x}\ny_mm = {y}\nfz_n = {fz}\nfx_n = {fx:.3}\n\
             fy_n = {fy:.3}\nrise_s = 0.04\nhold_s = {hold}\nfall_s = 0.04\n"
        );
        at += hold + 0.12;
    };
    (0..3).for_each(|_| press([0.0; 2], 2.0, [0.0; 2], 0.04));
    let centres = [-3.75, -1.25, 1.25, 3.75];
    for (x, y) in centres.iter().flat_map(|y| centres.map(|x| (x, *y))) {
        [0.4, 1.0, 1.8].into_iter().for_each(|fz| press([x, y], fz, [0.0; 2], 0.04));
    }
    for eighth in 0..8 {
        let (y, x) = (f64::from(eighth) * std::f64::consts::FRAC_PI_4).sin_cos();
        press([0.0; 2], 1.5, [0.7 * x, 0.7 * y], 0.04);
    }
    (0..3).for_each(|_| press([1.0; 2], 1.5, [0.0; 2], 0.7));
    (0..45).for_each(|_| press([-1.0; 2], 1.0, [0.0; 2], 0.04));
    scene
}

/// A load cell's clock is 2.7 s ahead, and the reference finger is late by 4 ms.
#[test]
fn lag_behind_the_clock_of_a_load_cell_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let simulate = ["simulate", "--scene", "shear", "--finger", "reference", "--seed", "2"];
    let short = ["--set", "scan.duration_s=32", "--set", "random.presses=150"];
    let out = ["--cell", "cell.csv", "--out", "codes.csv"];
    taxel.succeeds(&[&simulate[..], &short, &out].concat());
    // One force sensor of four tells it with help of the matrix.
    let codes = std::fs::read_to_string(folder.path().join("codes.csv")).unwrap();
    let mut rows = codes.lines().filter(|line| !line.starts_with('#')).peekable();
    let gone =
        |name: &str| ["bridge_s1", "bridge_s2", "bridge_s3"].iter().any(|s| name.starts_with(s));
    let kept: Vec<bool> = rows.peek().unwrap().split(',').map(|name| !gone(name)).collect();
    let comments = codes.lines().filter(|line| line.starts_with('#')).map(str::to_owned);
    let rows = rows.map(|row| {
        let cells = row.split(',').zip(&kept).filter(|(_, kept)| **kept).map(|(cell, _)| cell);
        cells.collect::<Vec<_>>().join(",")
    });
    let one: Vec<String> = comments.chain(rows).collect();
    std::fs::write(folder.path().join("one.csv"), one.join("\n") + "\n").unwrap();
    let fit = ["calibrate", "fit", "--reference", "cell.csv", "--model", "ridge", "--json"];
    let aligned = |more: &[&str]| {
        let fitted = taxel.succeeds(&[&fit[..], more].concat());
        crate::common::json(&fitted)["alignments"][0].clone()
    };
    let off = |found: &serde_json::Value| (found["offset_s"].as_f64().unwrap() - 2.7).abs();
    for (data, out) in [("codes.csv", "finger.toml"), ("one.csv", "one.toml")] {
        let found = aligned(&["--data", data, "--out", out]);
        assert!(off(&found) < 1e-3, "{data}: {found}");
        assert!((found["lag_s"].as_f64().unwrap() - 4e-3).abs() < 1e-3, "{data}: {found}");
    }
    // Nothing compensates it in a net alone.
    let hidden = aligned(&["--data", "codes.csv", "--net-only", "--out", "net.toml"]);
    assert!(off(&hidden) > 3e-3 && hidden["lag_s"].is_null(), "{hidden}");
}

/// A cell's moments give contact points; a place that is not its own is warned of.
#[test]
fn six_axis_load_cell_log_gives_contact_points() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("presses.toml", crate::common::SHORT_PRESSES);
    let simulate = ["simulate", "--scene", "presses.toml", "--seed", "3", "--out", "codes.csv"];
    taxel.succeeds(&[&simulate[..], &["--cell", "cell.csv", "--cell-axes", "6"]].concat());
    let fit = ["calibrate", "fit", "--data", "codes.csv", "--model", "ridge", "--force"];
    let fit = |more: &[&'static str]| [&fit[..], &["--out", "a.toml"], more].concat();
    let ran = taxel.taxel(&fit(&["--reference", "cell.csv", "--cell-at", "0,0,25"]));
    assert!(ran.code == Some(0) && !ran.err.contains("moments"), "{}{}", ran.out, ran.err);
    assert!(ran.out.contains(" rows from its moments\n"), "{}", ran.out);
    let used = |columns: &str| {
        let line = ran.out.lines().find(|line| line.starts_with(columns));
        line.and_then(|line| line.split_once("  used: ")).map(|(_, used)| used.to_owned())
    };
    assert_eq!(used("mx_nmm, my_nmm, mz_nmm").unwrap(), "x_mm, y_mm, torsion_nmm of the rows");
    assert!(used("x_mm, y_mm").unwrap().contains("array of sensors 6x12"), "{}", ran.out);
    let evaluate = ["calibrate", "evaluate", "--data", "codes.csv", "--calibration", "a.toml"];
    let evaluate = |more: &[&'static str]| [&evaluate[..], more].concat();
    let log = ["--reference", "cell.csv", "--cell-at", "0,0,25", "--json"];
    let judged = crate::common::json(&taxel.succeeds(&evaluate(&log)));
    assert!(judged["x_mm"]["rmse"].as_f64().unwrap() < 0.2, "{judged}");
    let warned = taxel.taxel(&evaluate(&["--reference", "cell.csv", "--cell-at", "-4,0,25"])).err;
    assert!(warned.contains("stood 4 mm elsewhere; --cell-at 0,0,2"), "{warned}");
    let error = taxel.fails(2, &evaluate(&["--reference", "cell.csv", "--cell-at", "0,25"]));
    assert!(error.contains("expected three numbers of millimetres, as in 0,0,25"), "{error}");
    let error = taxel.fails(2, &evaluate(&["--cell-at", "0,0,25"]));
    assert!(error.contains("--reference"), "{error}");
    let text = std::fs::read_to_string(folder.path().join("cell.csv")).unwrap();
    write("no-shear.csv", &text.replace("fx_n", "note").replace("fy_n", "mark"));
    let error = taxel.fails(1, &evaluate(&["--reference", "no-shear.csv"]));
    assert!(error.contains("no-shear.csv:1: `fx_n`: no column matches"), "{error}");
}

/// A log of other presses is refused; of the right one, columns that nothing reads are named.
#[test]
fn load_cell_log_of_other_presses_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    std::fs::write(folder.path().join("presses.toml"), crate::common::SHORT_PRESSES).unwrap();
    for (seed, cell, codes) in [("3", "a.csv", "codes-a.csv"), ("4", "b.csv", "codes-b.csv")] {
        let simulate = ["simulate", "--scene", "presses.toml", "--seed", seed];
        taxel.succeeds(&[&simulate[..], &["--cell", cell, "--out", codes]].concat());
    }
    let fit = ["calibrate", "fit", "--data", "codes-a.csv", "--model", "ridge", "--out", "a.toml"];
    let error = taxel.fails(1, &[&fit[..], &["--reference", "b.csv"]].concat());
    assert!(
        error.starts_with("taxel: b.csv: its correlation with codes-a.csv is 0.")
            && error.contains("where a log of the same presses has 0.98 or more; give each --data"),
        "{error}"
    );
    assert!(!folder.path().join("a.toml").exists());
    // Moments and unknown columns are named.
    let log = std::fs::read_to_string(folder.path().join("a.csv")).unwrap();
    let wider = |(i, line): (usize, &str)| {
        let more = if i == 0 { "mx_nmm,my_nmm,status" } else { "0,0,0" };
        format!("{line},{more}\n")
    };
    let wider = log.lines().enumerate().map(wider).collect::<String>();
    std::fs::write(folder.path().join("a.csv"), wider).unwrap();
    let ran = taxel.taxel(&[&fit[..], &["--reference", "a.csv"]].concat());
    assert!(ran.code == Some(0) && !ran.err.contains("correlation"), "{}", ran.err);
    for unused in ["mx_nmm, my_nmm  ", "status  "] {
        let line = ran.out.lines().find(|line| line.starts_with(unused)).unwrap();
        assert!(line.contains("  not used: "), "{}", ran.out);
    }
}

#[test]
fn finger_keeps_its_fields_after_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let (mut finger, port) = served(&taxel, &["--port", "sim:press", "--tcp", "127.0.0.1:0"]);
    let fields = || {
        let info = taxel.succeeds(&["info", "--port", &port, "--json"]);
        crate::common::json(&info)["fields"].clone()
    };
    let before = fields();
    assert!(!before.to_string().contains("codes"), "{before}");
    taxel.succeeds(&["record", "--port", &port, "--duration", "0.2", "--out", "a.mcap"]);
    assert_eq!(fields(), before);
    finger.kill().unwrap();
    finger.wait().unwrap();
    let recording = Recording::open(&folder.path().join("a.mcap")).unwrap();
    assert!(recording.position("lit_r0c0").is_some());
}

#[test]
fn replay_without_codes_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let args = ["record", "--port", "sim:press", "--duration", "0.2", "--fields", "force"];
    taxel.succeeds(&[args.as_slice(), &["--out", "a.mcap"]].concat());
    let error = taxel.fails(1, &["replay", "a.mcap", "--out", "b.csv"]);
    assert!(error.contains("a.mcap: no ADC codes in it"), "{error}");
    assert!(error.contains("record with the field `codes`"), "{error}");
}

#[test]
fn export_cuts_stretch_and_recovers_damaged_file() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    taxel.succeeds(&["record", "--port", "sim:press", "--duration", "3", "--out", "a.mcap"]);
    let all = rows(&folder.path().join("a.mcap"));
    let start = whole(&Recording::open(&folder.path().join("a.mcap")).unwrap(), &all[0], "t_us");
    let [from, to] = [1_000_000, 1_500_000].map(|micros| Stretch::seconds(start + micros));
    let stretch = format!("a.mcap@{from}..{to}");
    let said = taxel.succeeds(&["export", &stretch, "--out", "cut.parquet"]);
    assert!(said.starts_with("cut.parquet: 500 frames"), "{said}");

    let mut bytes = std::fs::read(folder.path().join("a.mcap")).unwrap();
    // Wider than the message index after each chunk.
    let middle = bytes.len() / 2;
    (middle..middle + 10_000).step_by(1000).for_each(|at| bytes[at] ^= 0xff);
    std::fs::write(folder.path().join("bad.mcap"), bytes).unwrap();
    let error = taxel.fails(1, &["export", "bad.mcap", "--out", "saved.mcap"]);
    assert!(error.contains("bad.mcap: damaged after row "), "{error}");
    let saved = rows(&folder.path().join("saved.mcap"));
    assert!(error.contains(&format!("saved.mcap has the {} frames", saved.len())), "{error}");
    assert!(saved.len() > 500 && saved.len() < 3000, "{}", saved.len());
}

/// Kills a writer, which may lose only the last second, in every file format.
#[cfg(unix)]
#[test]
fn kill_9_loses_at_most_the_last_second() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let files = ["--out", "a.mcap", "--out", "a.csv", "--out", "a.parquet"];
    let record = [["record", "--port", "sim:press"].as_slice(), &files].concat();
    let mut child = taxel.command(&record).spawn().unwrap();
    let mcap = folder.path().join("a.mcap");
    until("a recording", || Recording::open(&mcap).is_ok());
    // Ends between two flushes, whenever the first was.
    std::thread::sleep(Duration::from_millis(2300));
    // Host time of the kill, to compare with the column `host_us`.
    let killed = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    for name in ["a.mcap", "a.parquet.part.mcap", "a.csv"] {
        let path = folder.path().join(name);
        let recording = Recording::open(&path).unwrap();
        let at = recording.position("host_us").unwrap();
        // The last line of a CSV may be incomplete.
        let times = recording.map_while(Result::ok).map(|row| match row[at] {
            Cell::Whole(micros) => micros,
            other => panic!("{other:?}"),
        });
        let times: Vec<u64> = times.collect();
        let lost = killed.as_micros() as u64 - times.last().unwrap();
        assert!(lost < 1_000_000, "{name}: {lost} µs");
        assert!(times.len() > 1300, "{name}: {}", times.len());
    }
    // A second recording does not touch the remains of the first.
    let saved = rows(&folder.path().join("a.parquet.part.mcap"));
    let error = taxel.fails(1, &["record", "--port", "sim:press", "--out", "a.parquet"]);
    let mend = ["export", "a.parquet.part.mcap", "--out", "a.parquet"];
    assert!(error.contains(&format!("`taxel {}`", mend.join(" "))), "{error}");
    let said = taxel.succeeds(&mend);
    assert!(said.starts_with(&format!("a.parquet: {} frames", saved.len())), "{said}");
    assert!(rows(&folder.path().join("a.parquet")) == saved);
}

#[test]
fn forced_recording_replaces_its_file_at_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let names = ["a.mcap", "a.csv", "a.parquet"];
    let files: Vec<&str> = names.iter().flat_map(|name| ["--out", name]).collect();
    let typed = |words: &[&'static str]| [words, &files, &["--force"]].concat();
    let write = |name: &&str| std::fs::write(folder.path().join(name), "a quarter of an hour");
    names.iter().for_each(|name| write(name).unwrap());
    let before = taxel.files();
    // A finger without the matrix gives no row.
    taxel.fails(1, &typed(&["calibrate", "record", "--port", "sim:mems"]));
    assert_eq!(taxel.files(), before);
    // A killed recording leaves the former file and its own rows.
    let mut child = taxel.command(&typed(&["record", "--port", "sim:press"])).spawn().unwrap();
    let parts = ["a.mcap.part.mcap", "a.csv.part.csv", "a.parquet.part.mcap"];
    let recorded = |part: &&str| rows_so_far(&folder.path().join(part)) > 100;
    until("rows of every part", || parts.iter().all(recorded));
    child.kill().unwrap();
    child.wait().unwrap();
    for (name, part) in names.iter().zip(parts) {
        assert_eq!(taxel.files()[*name], before[*name], "{name}");
        let again =
            ["record", "--port", "sim:press", "--duration", "0.2", "--out", name, "--force"];
        let error = taxel.fails(1, &again);
        let mend = ["export", part, "--out", name, "--force"];
        assert!(error.contains(&format!("`taxel {}`", mend.join(" "))), "{error}");
        std::fs::remove_file(folder.path().join(part)).unwrap();
        taxel.succeeds(&again);
        assert!(rows(&folder.path().join(name)).len() > 50, "{name}");
    }
    assert_eq!(taxel.files().len(), names.len());
}

/// Unplugs a finger and plugs it in again, or another one in its place.
#[test]
fn recording_resumes_only_with_same_finger() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let address = {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        listener.local_addr().unwrap().to_string()
    };
    let serve = |scene: &str| {
        let port = format!("sim:{scene}");
        served(&taxel, &["--port", &port, "--tcp", &address]).0
    };
    let pull = |mut finger: Child| {
        finger.kill().unwrap();
        finger.wait().unwrap();
    };
    let record = |out: &str, duration: &str, scenes: [&str; 2]| {
        let port = format!("tcp:{address}");
        let args =
            ["record", "--port", &port, "--rate", "500", "--duration", duration, "--out", out];
        let finger = serve(scenes[0]);
        let recording = taxel.command(&args).spawn().unwrap();
        until("frames of the first finger", || rows_so_far(&folder.path().join(out)) > 150);
        pull(finger);
        std::thread::sleep(Duration::from_millis(700));
        let finger = serve(scenes[1]);
        let output = recording.wait_with_output().unwrap();
        pull(finger);
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (output.status.code(), text(output.stdout), text(output.stderr))
    };

    let (code, out, err) = record("a.mcap", "4", ["press", "press"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("the finger was gone 1×, "), "{out}");
    assert!(err.contains("waiting for it") && err.contains("connected again"), "{err}");
    let path = folder.path().join("a.mcap");
    let recording = Recording::open(&path).unwrap();
    let rows = rows(&path);
    let column = |name| rows.iter().map(|row| whole(&recording, row, name)).collect::<Vec<_>>();
    let (connection, host) = (column("connection"), column("host_us"));
    let again = connection.iter().position(|count| *count == 2).unwrap();
    assert!(again > 100 && rows.len() - again > 100, "{again} of {}", rows.len());
    assert!(connection.is_sorted() && connection.last() == Some(&2));
    // Longer than the absence, by at most 1 s.
    let gap = host[again] - host[again - 1];
    assert!((700_000..1_700_000 + 1_000_000).contains(&gap), "{gap} µs");
    // The rate is restored: a finger starts with twice the rate.
    let steps = host.last().unwrap() - host[again];
    let rate = (rows.len() - 1 - again) as f64 / steps as f64 * 1e6;
    assert!((rate - 500.0).abs() < 50.0, "{rate}");

    let (code, _, err) = record("b.mcap", "10", ["press", "shear"]);
    assert_eq!(code, Some(1));
    assert!(err.contains("another finger, shear, instead of press"), "{err}");
}

/// Simulates a full disk by a limit on file size, which any user may set.
#[cfg(unix)]
#[test]
fn full_disk_ends_recording_and_keeps_rows() {
    let folder = tempfile::tempdir().unwrap();
    for (name, kept) in
        [("a.mcap", "a.mcap"), ("a.csv", "a.csv"), ("a.parquet", "a.parquet.part.mcap")]
    {
        let script = "trap '' XFSZ; ulimit -f 2000; exec \"$0\" \"$@\"";
        let output = std::process::Command::new("bash")
            .args(["-c", script, env!("CARGO_BIN_EXE_taxel")])
            .args(["record", "--port", "sim:flicker", "--rate", "4000", "--fields", "all"])
            .args(["--out", name])
            .current_dir(folder.path())
            .output()
            .unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert!(said.starts_with(&format!("taxel: {name}")), "{said}");
        assert!(said.contains("too large") || said.contains("No space"), "{said}");
        let recording = Recording::open(&folder.path().join(kept)).unwrap();
        let rows = recording.map_while(Result::ok).count();
        assert!(rows > 100, "{name}: {rows}");
    }
}

/// Runs a command on a terminal and returns its output.
#[cfg(unix)]
fn on_a_terminal(mut command: std::process::Command) -> String {
    let terminal = nix::pty::openpty(None, None).unwrap();
    let child = command.stderr(terminal.slave).spawn();
    // Drops the slave end held by `command`, because the master ends only without it.
    drop(command);
    let said = crate::common::read_terminal(terminal.master.into());
    assert!(child.unwrap().wait().unwrap().success());
    said
}

#[cfg(unix)]
#[test]
fn progress_is_shown_only_on_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let record = ["record", "--port", "sim:press", "--duration", "2", "--out", "a.parquet"];
    let said = on_a_terminal(taxel.command(&record));
    let shares = said.split(" %").filter_map(|before| before.rsplit(' ').next()?.parse().ok());
    let shares: Vec<u32> = shares.collect();
    assert!(shares.is_sorted() && shares.iter().any(|share| (20..100).contains(share)), "{said}");
    assert!(said.contains(" frames, 0 lost"), "{said}");
    assert!(said.contains("writing a.parquet"), "{said}");
    let again = [record.as_slice(), &["--force"]].concat();
    assert_eq!(taxel.taxel(&again).err, "");

    let said = on_a_terminal(taxel.command(&["export", "a.parquet", "--out", "b.parquet"]));
    assert!(said.contains("writing b.parquet"), "{said}");
}

#[test]
fn stretch_without_frame_overwrites_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    taxel.succeeds(&["record", "--port", "sim:press", "--duration", "0.2", "--out", "a.mcap"]);
    std::fs::write(folder.path().join("b.csv"), "here before").unwrap();
    let error = taxel.fails(1, &["export", "a.mcap@1000..2000", "--out", "b.csv", "--force"]);
    assert!(error.starts_with("taxel: a.mcap: no frame within this stretch; "), "{error}");
    assert_eq!(std::fs::read_to_string(folder.path().join("b.csv")).unwrap(), "here before");
}

#[test]
fn recording_is_equal_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let taxel = In(folder.path());
    let record = ["record", "--port", "sim:press", "--duration", "0.5", "--fields", "all"];
    taxel.succeeds(&[record.as_slice(), &["--out", "a.mcap"]].concat());
    taxel.succeeds(&["export", "a.mcap", "--out", "b.parquet"]);
    taxel.succeeds(&["export", "b.parquet", "--out", "c.mcap"]);
    let (a, c) = (folder.path().join("a.mcap"), folder.path().join("c.mcap"));
    assert_eq!(rows(&a), rows(&c));
    assert_eq!(Recording::open(&a).unwrap().header, Recording::open(&c).unwrap().header);
    let error = taxel.fails(1, &["export", "a.mcap", "--out", "a.xlsx"]);
    assert!(error.contains("let it end in .mcap, .parquet or .csv"), "{error}");
    for again in [
        ["record", "--port", "sim:press", "--duration", "1", "--out", "a.mcap"].as_slice(),
        &["export", "a.mcap", "--out", "c.mcap"],
        &["replay", "a.mcap", "--out", "b.parquet"],
    ] {
        let error = taxel.fails(1, again);
        assert!(error.contains("the file exists already; "), "{error}");
    }
    taxel.succeeds(&["export", "a.mcap", "--out", "c.mcap", "--force"]);
    let twice = ["record", "--port", "sim:press", "--out", "d.mcap", "--out", "./d.mcap"];
    let error = taxel.fails(1, &twice);
    assert!(error.contains("./d.mcap: --out names it twice"), "{error}");
    assert!(!folder.path().join("d.mcap").exists());
    let error = taxel.fails(1, &["export", "a.mcap", "--out", "./a.mcap"]);
    assert!(error.contains("would overwrite"), "{error}");
}

/// Recordings of many presses, in real time.
mod endurance {
    use super::*;

    /// Records as a beginner does, and fits what was recorded.
    #[test]
    fn default_recording_can_be_fitted() {
        let folder = tempfile::tempdir().unwrap();
        let taxel = In(folder.path());
        std::fs::write(folder.path().join("presses.toml"), crate::common::SHORT_PRESSES).unwrap();
        let simulate = ["simulate", "--scene", "presses.toml", "--seed", "3"];
        taxel.succeeds(
            &[simulate.as_slice(), &["--cell", "cell.csv", "--out", "codes.csv"]].concat(),
        );
        taxel.succeeds(&["record", "--port", "file:codes.csv", "--out", "presses.mcap"]);
        let recording = Recording::open(&folder.path().join("presses.mcap")).unwrap();
        assert!(
            recording.position("fz_n").is_some() && recording.position("bridge_s0_a").is_some()
        );
        let fit = ["calibrate", "fit", "--data", "presses.mcap", "--reference", "cell.csv"];
        let fitted = taxel
            .succeeds(&[fit.as_slice(), &["--model", "ridge", "--out", "finger.toml"]].concat());
        assert!(fitted.contains("finger.toml"), "{fitted}");
        let again =
            ["replay", "presses.mcap", "--calibration", "finger.toml", "--out", "again.csv"];
        taxel.succeeds(&again);
    }

    #[test]
    fn guided_recording_ends_when_presses_are_enough() {
        let folder = tempfile::tempdir().unwrap();
        let taxel = In(folder.path());
        std::fs::write(folder.path().join("asked.toml"), asked_for()).unwrap();
        let record = ["calibrate", "record", "--port", "sim:asked.toml", "--out", "presses.mcap"];
        let ran = taxel.taxel(&record);
        assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
        let steps: Vec<&str> = ran.err.lines().collect();
        assert_eq!(steps[0], "touch nothing for a second");
        assert_eq!(steps[1], "press the middle 3 times, as hard as it will ever be pressed");
        assert_eq!(steps.last(), Some(&"enough"), "{}", ran.err);
        assert_eq!(ran.out.matches("[lmh").count(), 16, "{}", ran.out);
        assert!(ran.out.contains("sideways →↗↑↖←↙↓↘, held 3 of 3, fast 3 of 3"), "{}", ran.out);
        let recording = Recording::open(&folder.path().join("presses.mcap")).unwrap();
        assert!(recording.whole && recording.position("lit_r0c0").is_some());
        assert!(recording.map(Result::unwrap).count() > 5000);
        // A file that exists is kept, and a finger without the matrix is refused.
        let error = taxel.fails(1, &record);
        assert!(error.contains("the file exists already"), "{error}");
        let refused = ["calibrate", "record", "--port", "sim:mems", "--out", "bare.mcap"];
        let error = taxel.fails(1, &refused);
        assert!(
            error.contains("bare.mcap: the frames have no codes of the optical matrix"),
            "{error}"
        );
        assert!(!folder.path().join("bare.mcap").exists());
    }
}
