//! Warnings about shear that the recordings lack, or contain in one direction only.
//!
//! The estimate of such shear is a guess.

/// Reference columns with the components of a force, in newtons.
pub const FORCES: [&str; 3] = ["fx_n", "fy_n", "fz_n"];
/// Least shear, as a share of the normal force.
pub const NO_SHEAR: f64 = 0.01;
/// Least extent of a two-sided component on its weaker side, as a share of the stronger side.
const ONE_SIDED: f64 = 0.1;

/// Warnings about the targets of a table; columns named as in [`FORCES`] are in newtons.
pub fn of_table<'r>(
    targets: &[String],
    rows: impl IntoIterator<Item = &'r Vec<f64>>,
) -> Vec<String> {
    let columns = FORCES.map(|force| targets.iter().position(|target| target == force));
    of_forces(rows.into_iter().map(|row| columns.map(|column| Some(row[column?]))))
}

/// Warnings about rows of f_x, f_y, f_z, newtons, in full sentences.
pub fn of_forces(rows: impl Iterator<Item = [Option<f64>; 3]>) -> Vec<String> {
    let mut extents = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
    for row in rows {
        for ([low, high], force) in extents.iter_mut().zip(row) {
            let Some(force) = force else { continue };
            (*low, *high) = (low.min(force), high.max(force));
        }
    }
    let largest = |axis: usize| match extents[axis] {
        [low, high] if low > high => 0.0,
        [low, high] => low.abs().max(high.abs()),
    };
    let mut doubts = Vec::new();
    for (axis, name) in [(0, "x"), (1, "y")] {
        let [low, high] = extents[axis];
        if low > high {
            continue;
        }
        if largest(axis) < NO_SHEAR * largest(2) {
            doubts.push(format!(
                "no shear in {name} (less than {:.0} % of the normal force): f{name} is a guess; press and \
                 pull along {name}, both ways",
                100.0 * NO_SHEAR
            ));
        } else if low.abs().min(high.abs()) < ONE_SIDED * largest(axis) || low * high > 0.0 {
            doubts.push(format!(
                "f{name} goes one way only ({low:.2} … {high:.2} N): the other way is a guess; pull along \
                 {name} both ways"
            ));
        }
    }
    doubts
}
