//! How much stronger than the evidence asks the decay should be, found inside the training data.
//!
//! Stretches of time are left out in turn, never rows at random: neighbours in time repeat each other,
//! and a net that has seen one knows the other. Each time a net takes shape on what remains, then
//! follows the strengths from the weakest to the strongest, and each of its states is judged by what
//! was left out. Chosen is the strongest whose error is within one standard error of the least.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::levenberg::Decay;
use crate::mlp::Shape;
use crate::network::{Inputs, Meter, Net, NetOptions};
use crate::problem::{Problem, Row};
use crate::range::trained_range;

/// Strengths on trial. The evidence is right (1) if every row is news, and a thousand times too weak if
/// a second at a kilohertz tells one thing.
const STRENGTHS: [f64; 6] = [1.0, 4.0, 16.0, 64.0, 256.0, 1024.0];
/// Stretches that a recording is cut into.
const BLOCKS: usize = 5;
/// On either side of a stretch left out, so much of its length is not used at all: in a recording of
/// seconds this is longer than the skin takes to settle.
const GAP: f64 = 0.05;
/// Rows that a net on trial is trained on: a few for every parameter.
const ROWS: usize = 1024;
/// A recording is left out whole if in the others' range lies this share of its rows.
const ALIKE: f64 = 0.95;

/// Rows to train on and rows to judge by.
pub(crate) struct Fold<'r> {
    train: Vec<Row<'r>>,
    judge: Vec<Row<'r>>,
}

/// Leaves out whole recordings where the others reach as far, else a block of each.
pub(crate) fn folds<'r>(recordings: &[Vec<Row<'r>>]) -> Vec<Fold<'r>> {
    let mut folds: Vec<Fold<'r>> =
        (0..BLOCKS).map(|_| Fold { train: Vec::new(), judge: Vec::new() }).collect();
    let mut whole = 0;
    for (at, rows) in recordings.iter().enumerate() {
        if is_like_others(recordings, at) {
            for (block, fold) in folds.iter_mut().enumerate() {
                let side = if block == whole % BLOCKS { &mut fold.judge } else { &mut fold.train };
                side.extend(rows);
            }
            whole += 1;
        } else {
            let edge = |block: usize| block * rows.len() / BLOCKS;
            let gap = (GAP * rows.len() as f64 / BLOCKS as f64).ceil() as usize;
            for (block, fold) in folds.iter_mut().enumerate() {
                let (from, to) = (edge(block), edge(block + 1));
                fold.train.extend(&rows[..from.saturating_sub(gap)]);
                fold.judge.extend(&rows[from..to]);
                fold.train.extend(&rows[(to + gap).min(rows.len())..]);
            }
        }
    }
    folds.retain(|fold| !fold.judge.is_empty() && !fold.train.is_empty());
    folds
}

/// The other recordings reach as far as this one does, in inputs and in targets.
fn is_like_others(recordings: &[Vec<Row<'_>>], at: usize) -> bool {
    let others = || recordings.iter().enumerate().filter(move |(i, _)| *i != at).flat_map(|r| r.1);
    let Some(first) = others().next() else { return false };
    let columns = first.x.len() + first.y.len();
    let value =
        |row: &Row<'_>, i: usize| *row.x.get(i).unwrap_or_else(|| &row.y[i - row.x.len()]) as f32;
    let ranges: Vec<_> =
        (0..columns).map(|i| trained_range(others().map(|row| value(row, i)), 0.0)).collect();
    let within = |row: &&Row<'_>| {
        ranges.iter().enumerate().all(|(i, [low, high])| (low..=high).contains(&&value(row, i)))
    };
    recordings[at].iter().filter(within).count() as f64 >= ALIKE * recordings[at].len() as f64
}

/// Steps that a net on trial is given to take shape, and at each strength.
fn trial_steps(steps: usize) -> (usize, usize) {
    (steps / 5, steps / 15)
}

/// Steps of the whole search.
pub(crate) fn steps(folds: usize, steps: usize) -> usize {
    let (shaping, each) = trial_steps(steps);
    folds * (shaping + STRENGTHS.len() * each)
}

/// The strength that what was left out speaks for; none if stopped on the way.
pub(crate) fn choose(
    folds: &[Fold<'_>],
    net: (Shape, Inputs),
    options: NetOptions,
    meter: &mut Meter<'_>,
) -> Option<f64> {
    let mut scores = Vec::new();
    for (i, fold) in folds.iter().enumerate() {
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        rng.set_stream(1 + i as u64);
        let nets = trial(&fold.train, net, options.steps, &mut rng, meter);
        if !meter.goes_on() {
            return None;
        }
        scores.extend(nets.map(|nets| nets.map(|net| score(&net, &fold.judge))));
    }
    Some(STRENGTHS[strongest(&scores)])
}

/// Nets of every strength; none if a target never changes in these rows.
fn trial(
    rows: &[Row<'_>],
    (shape, inputs): (Shape, Inputs),
    steps: usize,
    rng: &mut ChaCha8Rng,
    meter: &mut Meter<'_>,
) -> Option<[Net; STRENGTHS.len()]> {
    let (shaping, each) = trial_steps(steps);
    let every = rows.len().div_ceil(ROWS);
    let thin: Vec<Row<'_>> = rows.iter().step_by(every).copied().collect();
    let Some(mut problem) = Problem::new(shape, inputs, &thin) else {
        meter.pass(shaping + STRENGTHS.len() * each);
        return None;
    };
    let start = problem.start(rng);
    let mut state = problem.explore(start, every as f64, shaping, meter);
    let mut before = 1.0;
    Some(STRENGTHS.map(|strength| {
        state.stiffen(strength / before);
        before = strength;
        state = problem.train(state.clone(), Decay::Held, each, meter);
        problem.net(&state, strength)
    }))
}

/// How far a net is off: the mean over its targets of ln(mean square error), so that a target counts
/// the same in newtons and in millinewtons.
fn score(net: &Net, rows: &[Row<'_>]) -> f64 {
    let mut squares = vec![f64::MIN_POSITIVE; net.output_bias.len()];
    for row in rows {
        let x: Vec<f32> = row.x.iter().map(|x| *x as f32).collect();
        for ((sum, found), wanted) in squares.iter_mut().zip(net.outputs(&x)).zip(row.y) {
            *sum += (f64::from(found) - wanted).powi(2);
        }
    }
    squares.iter().map(|sum| (sum / rows.len() as f64).ln()).sum::<f64>() / squares.len() as f64
}

/// Of scores by fold and strength, the strongest that is worse than the best by no more than one
/// standard error of the difference.
fn strongest<const N: usize>(scores: &[[f64; N]]) -> usize {
    let folds = scores.len() as f64;
    let sum = |i: usize| scores.iter().map(|fold| fold[i]).sum::<f64>();
    let best = (0..N).min_by(|a, b| sum(*a).total_cmp(&sum(*b))).unwrap_or_default();
    let close = |i: &usize| {
        let worse = || scores.iter().map(|fold| fold[*i] - fold[best]);
        let mean = worse().sum::<f64>() / folds;
        let variance = worse().map(|d| (d - mean).powi(2)).sum::<f64>() / (folds - 1.0).max(1.0);
        mean <= (variance / folds).sqrt()
    };
    (best..N).rev().find(close).unwrap_or(best)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    const NET: (Shape, Inputs) = (Shape { inputs: 2, hidden: 6, outputs: 1 }, Inputs::Unlike);
    const OPTIONS: NetOptions = NetOptions { seed: 0, starts: 1, steps: 150 };

    type Table = Vec<([f64; 2], [f64; 1])>;

    /// Strokes through a plane, their force off by `error` from stroke to stroke.
    fn strokes(count: usize, error: f64) -> Table {
        let row = |i: usize| {
            let (stroke, t) = ((i / 10) as f64, (i % 10) as f64 / 10.0);
            let x = [(12.9 * stroke).sin() + t, (7.3 * stroke).cos() - t];
            let off = error * (12.9898 * stroke * stroke).sin();
            (x, [(2.0 * x[0]).sin() + 0.5 * x[1] + off])
        };
        (0..10 * count).map(row).collect()
    }

    fn rows(table: &Table) -> Vec<Row<'_>> {
        table.iter().map(|(x, y)| Row { x, y }).collect()
    }

    fn quietly<T>(run: impl FnOnce(&mut Meter<'_>) -> T) -> T {
        let stop = AtomicBool::new(false);
        run(&mut Meter::new("net", 0, &mut |_| {}, &stop))
    }

    #[test]
    fn the_more_the_strokes_are_off_the_stronger_is_the_decay() {
        let chosen = |error| {
            let table = strokes(30, error);
            quietly(|meter| choose(&folds(&[rows(&table)]), NET, OPTIONS, meter)).unwrap()
        };
        let [sure, unsure] = [chosen(0.0), chosen(1.0)];
        assert!(sure < unsure, "{sure} {unsure}");
    }

    #[test]
    fn a_net_on_trial_never_sees_what_it_is_judged_by() {
        let mut table = strokes(30, 0.1);
        table[60..120].iter_mut().for_each(|(x, y)| {
            x.fill(f64::NAN);
            y.fill(f64::NAN);
        });
        let fold = &folds(&[rows(&table)])[1];
        assert!(fold.judge.iter().all(|row| row.y[0].is_nan()));
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let nets = quietly(|meter| trial(&fold.train, NET, 60, &mut rng, meter)).unwrap();
        assert!(nets.iter().all(|net| net.outputs(&[0.3, 0.2])[0].is_finite()));
    }

    #[test]
    fn every_row_is_left_out_once_and_its_neighbours_are_not_trained_on() {
        let table: Table = (0..200).map(|i| ([f64::from(i), 0.0], [f64::from(i)])).collect();
        let folds = folds(&[rows(&table)]);
        let times = |rows: &[Row<'_>]| rows.iter().map(|row| row.y[0]).collect::<Vec<_>>();
        let judged: Vec<f64> = folds.iter().flat_map(|fold| times(&fold.judge)).collect();
        assert_eq!(judged, times(&rows(&table)));
        for fold in &folds {
            let nearest = times(&fold.train)
                .into_iter()
                .flat_map(|t| times(&fold.judge).into_iter().map(move |j| (t - j).abs()))
                .fold(f64::INFINITY, f64::min);
            assert_eq!((fold.judge.len(), nearest), (40, 3.0));
        }
    }

    #[test]
    fn recordings_alike_are_left_out_whole_and_others_in_blocks() {
        let (one, two) = (strokes(30, 0.1), strokes(20, 0.0));
        let far: Table = two.iter().map(|(x, y)| (*x, [y[0] + 9.0])).collect();
        let judged = |recordings: &[Vec<Row<'_>>]| {
            folds(recordings).iter().map(|fold| fold.judge.len()).collect::<Vec<_>>()
        };
        assert_eq!(judged(&[rows(&one), rows(&two)]), [300, 200]);
        assert_eq!(judged(&[rows(&one), rows(&far)]), [100; 5]);
    }

    #[test]
    fn a_stronger_decay_wins_if_it_is_no_worse_than_chance_makes_it() {
        assert_eq!(strongest(&[[0.5, 0.1, 0.0], [0.5, 0.0, 0.2], [0.6, 0.1, 0.0]]), 2);
        assert_eq!(strongest(&[[0.5, 0.0, 0.3], [0.5, 0.0, 0.2], [0.6, 0.0, 0.3]]), 1);
    }
}
