//! Needs of the uses that a verdict speaks of.

use taxel::scan::SENSORS;

use crate::report::series::Kind;

/// Uses of a quantity, from the least to the most demanding.
pub(crate) struct Ladder {
    /// Unit of the needs.
    pub unit: &'static str,
    /// Largest error that each use bears, and the use.
    pub needs: [(f64, &'static str); 3],
}

/// Needs of a normal force.
const NORMAL: Ladder = Ladder {
    unit: "N",
    needs: [
        (0.2, "gripping sturdy objects"),
        (0.05, "holding fragile objects"),
        (0.01, "weighing to a gram"),
    ],
};
/// Needs of a shear force, in x and in y.
const SHEAR: Ladder = Ladder {
    unit: "N",
    needs: [
        (0.2, "telling a pull from a lift"),
        (0.05, "keeping a light grip from slipping"),
        (0.01, "feeling a gram pull sideways"),
    ],
};
/// Needs of a contact point, in x and in y.
const PLACE: Ladder = Ladder {
    unit: "mm",
    needs: [
        (2.0, "telling which taxel is pressed"),
        (0.5, "following an edge"),
        (0.1, "aligning parts"),
    ],
};
/// Needs of any other quantity, in percent of its span.
const PERCENT: Ladder = Ladder {
    unit: "%",
    needs: [(10.0, "telling low from high"), (3.0, "control"), (1.0, "measuring")],
};

/// Quantity with the series that tell it, and its needs.
pub(crate) struct Quantity {
    /// Name in the report.
    pub name: String,
    /// Kinds of its series; the worst counts.
    pub kinds: Vec<Kind>,
    /// Needs of its uses.
    pub ladder: &'static Ladder,
}

/// Quantities of a finger: force, contact point, and each force sensor.
pub(crate) fn of_finger() -> Vec<Quantity> {
    let quantity = |name: &str, kinds, ladder| Quantity { name: name.into(), kinds, ladder };
    let on_sensors = |axes: &[usize]| -> Vec<Kind> {
        (0..SENSORS).flat_map(|i| axes.iter().map(move |axis| Kind::Sensor(i, *axis))).collect()
    };
    vec![
        quantity("normal force", vec![Kind::Force(2)], &NORMAL),
        quantity("shear", vec![Kind::Force(0), Kind::Force(1)], &SHEAR),
        quantity("contact place", vec![Kind::Point(0), Kind::Point(1)], &PLACE),
        quantity("normal force on each sensor", on_sensors(&[2]), &NORMAL),
        quantity("shear on each sensor", on_sensors(&[0, 1]), &SHEAR),
    ]
}

/// Quantities of a table: its targets.
pub(crate) fn of_table(targets: &[String]) -> Vec<Quantity> {
    let quantity = |name: &String| Quantity {
        name: name.clone(),
        kinds: vec![Kind::Column(name.clone())],
        ladder: &PERCENT,
    };
    targets.iter().map(quantity).collect()
}
