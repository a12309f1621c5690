//! Stages of other papers' sensors: line of four, feeler, columns.

use taxel::measured::NoValue;
use taxel::scan::TAXELS;
use taxel_papers::column::{Column, friction_distribution, inclination, quadrants};
use taxel_papers::feeler::{BrightSpot, Shear, Spot};
use taxel_papers::line_of_four::LinePolynomials;

use crate::Meter;

pub fn stages(c: impl Iterator<Item = [f32; TAXELS]> + Clone, meter: &mut impl Meter) {
    let line = c.clone().map(|c| [c[0], c[1], c[2], c[3]]);
    let mut row = LinePolynomials { point: [0.3; 8], angle: [0.2; 8] };
    meter.stage("DeMaria2011: line of four", &mut row, line, &mut (0.0, 0.0), |row, u, out| {
        *out = row.contact(*u);
    });
    let mut feeler = BrightSpot { normal: 0.01, x: Shear::PAPER, y: Shear::PAPER };
    let images = c.clone().map(|c| c.map(|c| 1.0 - c));
    meter.stage(
        "Ohka2005: feeler, 16 pixels",
        &mut feeler,
        images,
        &mut [0.0; 3],
        |feeler, grey, out| {
            let spot = Spot::measure(grey, 4, 1.0);
            *out = feeler.force(spot.integral, spot.centroid);
        },
    );
    let nothing = Err(NoValue::IllConditioned);
    meter.stage(
        "Ohka2004: four columns",
        &mut Column::PAPER.clone(),
        c.clone(),
        &mut nothing.clone(),
        |column, c, out| {
            let sunk = quadrants(c).map(|areas| column.load(areas).sunk);
            *out = inclination(&sunk, 5.0);
        },
    );
    meter.stage(
        "Ohka2004: distribution of friction",
        &mut Column::PAPER.clone(),
        c,
        &mut [nothing; 4],
        |column, c, out| {
            *out = friction_distribution(&quadrants(c).map(|areas| column.load(areas)), 0.02);
        },
    );
}
