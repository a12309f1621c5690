//! Touches that a finger tells although nothing touches it: light, warmth or an LED changed.

use std::fmt::Write as _;
use std::sync::atomic::{AtomicUsize, Ordering};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use taxel::calibration::Calibration;
use taxel::finger::{Estimate, Finger, FingerState, Wanted};
use taxel::frame::{Fields, Status};
use taxel::scan::{Codes, SENSORS, Scan, TaxelCodes};
use taxel_sim::scene::{Changes, REFERENCE_C};
use taxel_sim::{Scene, Simulator};

use crate::effort::{Waiting, on_all_cores};
use crate::faults::{brighten, shift};
use crate::reference::{BIAS, TOP, calibrated, of_board, without_sensors};

/// Devices of which each is calibrated on its own recordings.
const DEVICES: [u64; 2] = [1, 2];
/// Seed of noise, lamps and steps; no calibration has it.
const SEED: u64 = 44;
/// Scans a second, as the board's.
const RATE: usize = 4000;
/// Scans of each condition, over all devices.
const SCANS: usize = 1_000_000;
/// Time in seconds of a whole change, there and back.
const SWING_S: f64 = 60.0;
/// Scans between two steps.
const STEP_SCANS: usize = RATE / 2;
/// Fingers: whether they have force sensors, and their names.
const PARTS: [(bool, &str); 2] = [(false, "matrix"), (true, "both")];

/// Change of the surroundings, or of the finger.
#[derive(Clone, Copy, Debug)]
enum Change {
    Nothing,
    /// All LEDs swing slowly by this share.
    LedsSwing(f64),
    /// All LEDs jump by this share, there and back.
    LedsStep(f64),
    /// The LEDs of one row swing slowly by this share.
    RowSwings(f64),
    /// The finger warms by so many kelvin.
    Warms(f64),
    /// The light of the room jumps by this share of the converter's range, within a scan.
    RoomSteps(f64),
    /// The light of the room swings slowly by this share of the converter's range.
    RoomSwings(f64),
}

const CHANGES: [(Change, &str); 11] = [
    (Change::Nothing, "nothing"),
    (Change::LedsSwing(0.02), "all LEDs swing by ±2 % in 60 s"),
    (Change::LedsStep(0.02), "all LEDs jump by 2 %, twice a second"),
    (Change::LedsStep(-0.02), "all LEDs jump by −2 %, twice a second"),
    (Change::RowSwings(0.02), "LEDs of a row swing by ±2 % in 60 s"),
    (Change::Warms(10.0), "warms by 10 K in 60 s"),
    (Change::Warms(-10.0), "cools by 10 K in 60 s"),
    (Change::Warms(20.0), "warms by 20 K in 60 s"),
    (Change::RoomSteps(0.02), "light of the room jumps by 2 % of the range, twice a second"),
    (Change::RoomSteps(0.2), "light of the room jumps by 20 % of the range, twice a second"),
    (Change::RoomSwings(0.2), "light of the room swings by 20 % of the range in 60 s"),
];

/// Result of one change on one kind of finger, over all devices.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Idle {
    /// Change while nothing touches.
    pub change: String,
    /// Finger: `matrix` or `both`.
    pub part: String,
    /// Scans, each with a frame.
    pub scans: usize,
    /// Frames that tell a contact.
    pub touched: usize,
    /// Touches: frames with a contact after one without.
    pub touches: usize,
    /// Largest force in these frames, in mN.
    pub most_mn: f64,
    /// Frames with a flag of a fault.
    pub faults: usize,
}

/// Measures every change on both kinds of finger; takes a minute or two.
///
/// # Errors
/// The fit failed or was stopped.
pub fn measure(waiting: Waiting<'_>) -> anyhow::Result<Vec<Idle>> {
    (waiting.progress)(0.0, "calibrating");
    let records = on_all_cores(&DEVICES, |device| calibrated(*device, false, waiting.stop))?;
    let work: Vec<(usize, usize)> =
        (0..CHANGES.len()).flat_map(|c| (0..DEVICES.len()).map(move |d| (c, d))).collect();
    let begun = AtomicUsize::new(0);
    let counts = on_all_cores(&work, |(c, d)| {
        anyhow::ensure!(!waiting.stop.load(Ordering::Relaxed), "stopped");
        let (change, name) = CHANGES[*c];
        let share = begun.fetch_add(1, Ordering::Relaxed) as f64 / work.len() as f64;
        (waiting.progress)(share, &format!("finger {}: {name}", DEVICES[*d]));
        counted(DEVICES[*d], change, &records[*d])
    })?;
    let mut rows = Vec::new();
    for (own, (_, name)) in counts.chunks(DEVICES.len()).zip(CHANGES) {
        for (p, (_, part)) in PARTS.into_iter().enumerate() {
            let mut row = Idle { change: name.into(), part: part.into(), ..Idle::default() };
            own.iter().for_each(|of_device| row.add(&of_device[p]));
            rows.push(row);
        }
    }
    Ok(rows)
}

/// Frames of one device during one change, as each of [`PARTS`] tells them.
fn counted(device: u64, change: Change, record: &Calibration) -> anyhow::Result<[Idle; 2]> {
    let mut fingers = PARTS.map(|(sensors, _)| {
        let record = if sensors { record.clone() } else { without_sensors(record) };
        let (finger, mut state) = Finger::new(Some(record));
        state.take_bias(BIAS);
        (finger, state)
    });
    let mut rows: [Idle; 2] = Default::default();
    let mut disturbance = Disturbance::new(change);
    let scene = scene(device, change)?;
    for (n, sample) in Simulator::new(&scene, SEED).take(SCANS / DEVICES.len()).enumerate() {
        let codes = disturbance.apply(n, of_board(sample.scan.codes));
        for (((finger, state), row), (sensors, _)) in fingers.iter_mut().zip(&mut rows).zip(PARTS) {
            let mut scan = Scan { codes, ..sample.scan };
            if !sensors {
                scan.codes.bridges = [None; SENSORS];
            }
            row.add_frame(finger, state, &scan);
        }
    }
    Ok(rows)
}

/// The reference finger at rest.
fn scene(device: u64, change: Change) -> anyhow::Result<Scene> {
    let seconds = SCANS.div_ceil(DEVICES.len()).div_ceil(RATE);
    let mut text = format!(
        "effects = []\n[scan]\nrate_hz = {RATE}\nduration_s = {seconds}\n[device]\nseed = {device}\n\
         bits = 16\n"
    );
    let mut set = Vec::new();
    if let Change::Warms(by) = change {
        let (start, end) = (REFERENCE_C, REFERENCE_C + by);
        let _ = write!(
            text,
            "[temperature]\nstart_c = {start}\nend_c = {end}\nfrom_s = 2\nramp_s = {SWING_S}\n"
        );
        set.push("effects.temperature=true".to_owned());
    }
    Ok(Scene::parse_changed("idle.toml", &text, &Changes { reference: true, set })?)
}

/// Change of the codes, scan by scan, from the end of the bias on.
struct Disturbance {
    change: Change,
    /// Places in a scan at which the light of the room jumps.
    rng: ChaCha8Rng,
}

impl Disturbance {
    fn new(change: Change) -> Self {
        Self { change, rng: ChaCha8Rng::seed_from_u64(SEED) }
    }

    /// Returns the codes of scan `n` under the change.
    fn apply(&mut self, n: usize, mut codes: Codes) -> Codes {
        let Some(since) = n.checked_sub(2 * usize::from(BIAS)) else { return codes };
        let Some(TaxelCodes { lit, dark }) = &mut codes.taxels else { return codes };
        let swing = (core::f64::consts::TAU * since as f64 / (SWING_S * RATE as f64)).sin();
        let (stepped, first) = (since / STEP_SCANS % 2 == 1, since % STEP_SCANS == 0);
        let mut light = |rows: core::ops::Range<usize>, by: f64| {
            let rows = lit.get_mut(rows).into_iter().flatten();
            rows.for_each(|row| brighten(row, dark, by, TOP));
        };
        match self.change {
            Change::Nothing | Change::Warms(_) => {}
            Change::LedsSwing(by) => light(0..4, by * swing),
            Change::LedsStep(by) => light(0..4, if stepped { by } else { 0.0 }),
            Change::RowSwings(by) => light(1..2, by * swing),
            Change::RoomSteps(by) | Change::RoomSwings(by) => {
                let by = by * f64::from(TOP);
                let swings = matches!(self.change, Change::RoomSwings(_));
                // The dark step comes first, then the rows. The light jumps before one of them.
                let jump = if first && since > 0 { self.rng.random_range(0..=4) } else { 0 };
                for (place, row) in [dark].into_iter().chain(lit).enumerate() {
                    let on = stepped == (place >= jump);
                    let by = if swings { by * 0.5 * (1.0 + swing) } else { by * f64::from(on) };
                    row.iter_mut().for_each(|code| shift(code, by, TOP));
                }
            }
        }
        codes
    }
}

impl Idle {
    fn add_frame(&mut self, finger: &Finger, state: &mut FingerState, scan: &Scan) {
        let wanted = Wanted { fields: Fields::ESTIMATES, due: true };
        let mut estimate = Estimate::NOTHING;
        let before = state.contact();
        finger.update(&mut estimate, state, scan, wanted);
        self.scans += 1;
        self.faults += usize::from(crate::detection::tells_fault(estimate.status));
        if !estimate.status.contains(Status::CONTACT) {
            return;
        }
        self.touched += 1;
        self.touches += usize::from(!before);
        let force = &estimate.force;
        for newtons in [force.x, force.y, force.z].into_iter().filter_map(Result::ok) {
            self.most_mn = self.most_mn.max(1e3 * f64::from(newtons.0.abs()));
        }
    }

    fn add(&mut self, other: &Self) {
        self.scans += other.scans;
        self.touched += other.touched;
        self.touches += other.touches;
        self.faults += other.faults;
        self.most_mn = self.most_mn.max(other.most_mn);
    }
}

/// Draws the table of the page: a row for each change.
#[must_use]
pub fn section(rows: &[Idle]) -> String {
    let mut table =
        "| while nothing touches | frames with a contact, matrix alone | with force sensors | \
                     largest force in them | frames with a fault's flag |\n|---|---|---|---|---|"
            .to_owned();
    for (_, change) in CHANGES {
        let own: Vec<&Idle> = rows.iter().filter(|row| row.change == change).collect();
        let touched = |part: &str| {
            let row = own.iter().find(|row| row.part == part);
            row.map_or("–".to_owned(), |row| match row.touched {
                0 => format!("0 of {}", row.scans),
                n => format!("**{n}** in {} touches", row.touches),
            })
        };
        let most = own.iter().fold(0.0, |most: f64, row| most.max(row.most_mn));
        let most = if most > 0.0 { format!("{most:.0} mN") } else { "–".to_owned() };
        let faults: usize = own.iter().map(|row| row.faults).sum();
        let _ = write!(
            table,
            "\n| {change} | {} | {} | {most} | {faults} |",
            touched("matrix"),
            touched("both")
        );
    }
    table
}
