//! Stages of all shapes of models in the papers and the trainer, with the trainer's names.

use heapless::{String, Vec};
use taxel::estimate::net::{ForceNet, Layers, MAX_HIDDEN};
use taxel::estimate::quantised::{QuantisedNet, Rows};
use taxel::scan::TAXELS;

use crate::Meter;

/// Components of a force.
const OUTPUTS: usize = 3;
/// Seed of all weights.
const SEED: u32 = 0x2545_f491;
/// Largest signal in contact.
const LARGEST: f32 = 0.6;
/// Terms of the cubic model: each signal, its square and its cube.
const CUBIC: usize = 3 * TAXELS;
/// Terms of the quadratic model: each signal and each product of two.
const QUADRATIC: usize = TAXELS + TAXELS * (TAXELS + 1) / 2;

/// Generator of weights for the measured models.
///
/// The values do not change the cost as long as the units work where tanh bends.
struct Weights(u32);

impl Weights {
    fn word(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }

    fn next(&mut self, scale: f32) -> f32 {
        (self.word() >> 8) as f32 / (1u32 << 23) as f32 * scale - scale
    }

    fn rows<const N: usize>(&mut self) -> Rows<N> {
        let row = |_| core::array::from_fn(|_| self.word() as i16);
        Rows::new(&core::array::from_fn(row))
    }

    fn net(&mut self, Shape { hidden, outputs, skip }: Shape) -> ForceNet {
        let mut list = |count: usize, scale| -> Vec<f32, { MAX_HIDDEN * TAXELS }> {
            (0..count).map(|_| self.next(scale)).collect()
        };
        let layers = Layers {
            hidden: &list(hidden * TAXELS, 6.0),
            hidden_bias: &list(hidden, 0.5),
            output: &list(hidden * outputs, 0.5),
            skip: &list(usize::from(skip) * outputs * TAXELS, 1.0),
            output_bias: &list(outputs, 0.1),
        };
        ForceNet::new(&layers).unwrap_or_default()
    }

    /// Net of the same shape with random bits as weights.
    fn wild(&mut self, like: &QuantisedNet) -> QuantisedNet {
        let mut wild = like.clone();
        for group in &mut wild.hidden {
            group.weights = self.rows();
            group.bias = core::array::from_fn(|_| self.word() as i32);
        }
        wild.shift = self.word().to_le_bytes()[0] % 32;
        let rows = wild.output.iter_mut().chain(&mut wild.skip);
        rows.for_each(|rows| *rows = self.rows());
        wild
    }

    /// Signals of a finger, an eighth of them extreme values.
    fn signals(&mut self) -> [f32; TAXELS] {
        const EXTREME: [f32; 16] = [
            0.0,
            -0.0,
            LARGEST,
            -LARGEST,
            1.0,
            -1.0,
            1e-5,
            -1e-5,
            f32::MIN_POSITIVE,
            1e-44,
            1e30,
            f32::MAX,
            f32::MIN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            f32::NAN,
        ];
        core::array::from_fn(|_| {
            let [which, extreme, ..] = self.word().to_le_bytes();
            match EXTREME.get(usize::from(extreme) % EXTREME.len()) {
                Some(extreme) if which < 32 => *extreme,
                _ => self.next(1.1 * LARGEST),
            }
        })
    }
}

#[derive(Clone, Copy)]
struct Shape {
    hidden: usize,
    outputs: usize,
    skip: bool,
}

impl Shape {
    fn name(self) -> String<24> {
        let mut name = String::new();
        let Self { hidden, outputs, .. } = self;
        // No name is longer than "skip 16-32-3".
        let _ = match self {
            Self { hidden: 0, .. } => {
                core::fmt::write(&mut name, format_args!("linear 16-{outputs}"))
            }
            Self { skip: true, .. } => {
                core::fmt::write(&mut name, format_args!("skip 16-{hidden}-{outputs}"))
            }
            _ => core::fmt::write(&mut name, format_args!("net 16-{hidden}-{outputs}")),
        };
        name
    }
}

/// Net of [DeMaria2011] for three force components, compared with other libraries.
pub fn papers_net() -> ForceNet {
    Weights(SEED).net(Shape { hidden: 16, outputs: OUTPUTS, skip: false })
}

/// Net of [`papers_net`] in 16 bits.
pub fn papers_net_quantised() -> Option<QuantisedNet> {
    QuantisedNet::new(&papers_net(), LARGEST)
}

pub fn stages(c: impl Iterator<Item = [f32; TAXELS]> + Clone, meter: &mut impl Meter) {
    for shape in shapes() {
        let mut net = Weights(SEED).net(shape);
        if let Some(mut net) = QuantisedNet::new(&net, LARGEST) {
            let mut name = String::<24>::new();
            // No name is longer than "q15 skip 16-32-3".
            let _ = core::fmt::write(&mut name, format_args!("q15 {}", shape.name()));
            meter.stage(&name, &mut net, c.clone(), &mut Vec::new(), |net, c, out| {
                *out = net.forces(c);
            });
        }
        meter.stage(&shape.name(), &mut net, c.clone(), &mut Vec::new(), |net, c, out| {
            *out = net.forces(c);
        });
    }
    polynomials(&mut Weights(SEED), c, meter);
    in_every_bit(meter);
}

/// Shapes: the paper's own, a linear map, and nets of every width that is charted or judged.
fn shapes() -> impl Iterator<Item = Shape> {
    let papers = Shape { hidden: 12, outputs: 1, skip: false };
    let linear = Shape { hidden: 0, outputs: OUTPUTS, skip: true };
    let wide = |skip| {
        let widths = [2, 4, 6, 8, 12, 16, MAX_HIDDEN];
        widths.map(|hidden| Shape { hidden, outputs: OUTPUTS, skip })
    };
    [papers, linear].into_iter().chain(wide(false)).chain(wide(true))
}

/// Signals of a call, and calls of a net.
///
/// With 16 shapes of two kinds each these are 12 288 signals.
const BATCH: usize = 32;
const BATCHES: u32 = 12;

/// Compares 16-bit nets on the core and the host bit for bit, on any signals.
///
/// They are nets that a record may hold, and nets that none may, whose sums can overflow.
fn in_every_bit(meter: &mut impl Meter) {
    let mut weights = Weights(SEED);
    let mut seed = SEED;
    for shape in shapes() {
        let Some(sound) = QuantisedNet::new(&weights.net(shape), LARGEST) else { continue };
        let wild = weights.wild(&sound);
        for mut net in [sound, wild] {
            let batches = seed..seed + BATCHES;
            seed += BATCHES;
            meter.compare(
                "q15, any signals",
                &mut net,
                batches,
                &mut Vec::<_, BATCH>::new(),
                |net: &mut QuantisedNet, seed, out| {
                    let mut numbers = Weights(seed.wrapping_mul(0x9e37_79b9));
                    out.clear();
                    out.extend((0..BATCH).map(|_| net.forces(&numbers.signals())));
                },
            );
        }
    }
}

fn polynomials(
    weights: &mut Weights,
    c: impl Iterator<Item = [f32; TAXELS]> + Clone,
    meter: &mut impl Meter,
) {
    let out = &mut [0.0; OUTPUTS];
    let mut cubic = core::array::from_fn(|_| weights.next(1.0));
    meter.stage(
        "cubic 16-3",
        &mut cubic,
        c.clone(),
        out,
        |weights: &mut [f32; OUTPUTS * CUBIC], c, y| {
            let mut terms = [0.0; CUBIC];
            let powers =
                c.iter().copied().chain(c.iter().map(|c| c * c)).chain(c.iter().map(|c| c * c * c));
            terms.iter_mut().zip(powers).for_each(|(term, power)| *term = power);
            *y = line(weights, &terms);
        },
    );
    let mut quadratic = core::array::from_fn(|_| weights.next(1.0));
    meter.stage(
        "quadratic 16-3",
        &mut quadratic,
        c,
        out,
        |weights: &mut [f32; OUTPUTS * QUADRATIC], c, y| {
            let mut terms = [0.0; QUADRATIC];
            let products =
                c.iter().enumerate().flat_map(|(i, a)| c.iter().skip(i).map(move |b| a * b));
            terms
                .iter_mut()
                .zip(c.iter().copied().chain(products))
                .for_each(|(term, product)| *term = product);
            *y = line(weights, &terms);
        },
    );
}

/// Linear map of some terms.
fn line(weights: &[f32], terms: &[f32]) -> [f32; OUTPUTS] {
    let mut y = [0.0; OUTPUTS];
    let layers = Layers {
        hidden: &[],
        hidden_bias: &[],
        output: &[],
        skip: weights,
        output_bias: &[0.1, 0.2, 0.3],
    };
    layers.outputs(terms, &mut y);
    y
}
