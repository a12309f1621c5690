//! Nets of every shape that the papers and the trainer use.

use heapless::Vec;
use taxel::estimate::net::ForceNet;
use taxel::scan::TAXELS;

use crate::Meter;

/// A net of the given shape. What the weights are does not matter to the cost, only that the units work
/// where tanh bends.
fn net(hidden: usize, outputs: usize, skip: bool) -> ForceNet {
    let mut state = 0x2545_f491u32;
    let mut weight = |scale: f32| {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        (state >> 8) as f32 / (1u32 << 23) as f32 * scale - scale
    };
    ForceNet {
        hidden: (0..hidden * TAXELS).map(|_| weight(6.0)).collect(),
        hidden_bias: (0..hidden).map(|_| weight(0.5)).collect(),
        output: (0..hidden * outputs).map(|_| weight(0.5)).collect(),
        skip: (0..if skip { outputs * TAXELS } else { 0 }).map(|_| weight(1.0)).collect(),
        output_bias: (0..outputs).map(|_| weight(0.1)).collect(),
    }
}

pub fn stages(c: impl Iterator<Item = [f32; TAXELS]> + Clone, meter: &mut impl Meter) {
    for (name, hidden, outputs, skip) in [
        ("net 16-12-1", 12, 1, false),
        ("net 16-16-3", 16, 3, false),
        ("net linear + 6 tanh, 3 outputs", 6, 3, true),
        ("net linear + 16 tanh, 3 outputs", 16, 3, true),
        ("net linear, 3 outputs", 0, 3, true),
    ] {
        let mut net = net(hidden, outputs, skip);
        meter.stage(name, &mut net, c.clone(), &mut Vec::new(), |net, c, out| *out = net.forces(c));
    }
}
