//! Error and cost of the three forms of the limit surface on the chip.

use std::fmt::Write as _;
use std::path::Path;

use taxel::estimate::limit_surface::Sweep;
use taxel_calibrate::limit_surface::{power_law, sweep};

/// Exponents of the pressure: [Ospina2017]'s fingers and Hertz's, from a nearly pointed to a blunt
/// one.
const PRESSURES: [f64; 4] = [1.8, 2.0, 3.0, 8.0];

/// Forms with their stages in the table of cycles.
pub const FORMS: [(&str, &str); 3] = [
    ("ellipse", "slip: the ellipse"),
    ("table", "slip: the limit surface"),
    ("sweep", "slip: the limit surface, swept"),
];

/// Load of a form as a function of shear, torsion, normal force and friction.
type Load = Box<dyn Fn(f32, f32, f32, f32) -> f32>;

/// Largest error of a form's load on the finely swept curve of any pressure; its load there is one.
pub fn error(form: &str) -> f64 {
    let radius = [1.5, 0.3];
    let worst = |k: f64| {
        let table = power_law(k, radius[0], radius[1]);
        let load: Load = match form {
            "ellipse" => Box::new(move |f, t, n, mu| table.load_by_ellipse([f, 0.0], t, n, mu)),
            "table" => Box::new(move |f, t, n, mu| table.load([f, 0.0], t, n, mu)),
            _ => {
                let swept = Sweep::power_law(k as f32, radius.map(|r| r as f32));
                Box::new(move |f, t, n, mu| swept.load([f, 0.0], t, n, mu))
            }
        };
        let (normal, mu) = (1.3, 0.7);
        let (held, a) = (mu * normal, radius[0] * f64::powf(normal, radius[1]));
        let off = |(force, torsion): &(f64, f64)| {
            let [force, torsion] = [force * held, torsion * held * a].map(|x| x as f32);
            (f64::from(load(force, torsion, normal as f32, mu as f32)) - 1.0).abs()
        };
        sweep(k).iter().map(off).fold(0.0, f64::max)
    };
    PRESSURES.into_iter().map(worst).fold(0.0, f64::max)
}

/// Modelled cycles of a stage, loads not pipelined, as counted by `cargo xtask cycles`.
fn cycles(stage: &str) -> u64 {
    let table = Path::new(env!("CARGO_MANIFEST_DIR")).join("../emulator/data/cycles.csv");
    let text =
        std::fs::read_to_string(&table).unwrap_or_else(|e| panic!("{}: {e}", table.display()));
    let numbers = text.lines().find_map(|line| line.strip_prefix(&format!("\"{stage}\",")));
    let numbers = numbers.unwrap_or_else(|| panic!("{}: no stage {stage}", table.display()));
    numbers.split(',').nth(2).and_then(|cycles| cycles.parse().ok()).expect("a count of cycles")
}

/// Renders the current content of the committed table.
pub fn table() -> String {
    let mut text = String::from("form,worst_error_percent,cycles\n");
    for (form, stage) in FORMS {
        writeln!(text, "{form},{:.2},{}", 100.0 * error(form), cycles(stage)).unwrap();
    }
    text
}
