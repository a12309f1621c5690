//! What must hold for the fields of each section.
//!
//! Comparisons with a NaN are false, so each of these refuses NaN without naming it.

use heapless::Vec;

use super::section::{Checks, Coefficients, HUGE, finite};
use super::{Range, SensorCalibration, TaxelCalibration};
use crate::condition::Bias;
use crate::estimate::net::ForceNet;

impl Coefficients for TaxelCalibration {
    const CHECKS: Checks<Self> = &[
        ("bias", |t| levels_fit(&t.bias.level)),
        ("noise", |t| noise_fits(t.bias.noise)),
        ("range", |t| ranges_fit(&t.range)),
        ("residual_n", |t| residuals_fit(&t.residual)),
    ];
}

impl Coefficients for ForceNet {
    const CHECKS: Checks<Self> = &[
        ("hidden", Self::hidden_layer_fits),
        ("output", Self::output_layer_fits),
        ("skip", Self::skip_fits),
    ];
    const NEEDS_TAXELS: bool = true;

    fn read(place: &mut Option<Self>, bytes: &[u8]) -> Option<()> {
        let net = place.insert(Self::EMPTY);
        let rest = read_list(&mut net.hidden, bytes)?;
        let rest = read_list(&mut net.hidden_bias, rest)?;
        let rest = read_list(&mut net.output, rest)?;
        let rest = read_list(&mut net.skip, rest)?;
        let rest = read_list(&mut net.output_bias, rest)?;
        rest.is_empty().then_some(())
    }
}

impl Coefficients for SensorCalibration {
    const CHECKS: Checks<Self> = &[
        ("bias", |s| levels_fit(&s.bias.level)),
        ("noise", |s| noise_fits(s.bias.noise)),
        ("sensitivity", |s| finite(s.sensitivity.0.as_flattened())),
        ("range", |s| ranges_fit(&s.range)),
        ("residual_n", |s| residuals_fit(&s.residual)),
    ];
}

/// Reads one of postcard's lists in place. Returns what follows it.
fn read_list<'b, const N: usize>(list: &mut Vec<f32, N>, bytes: &'b [u8]) -> Option<&'b [u8]> {
    let (length, rest) = postcard::take_from_bytes::<u32>(bytes).ok()?;
    let (weights, rest) = rest.split_at_checked(usize::try_from(length).ok()?.checked_mul(4)?)?;
    list.clear();
    for weight in weights.as_chunks::<4>().0 {
        list.push(f32::from_le_bytes(*weight)).ok()?;
    }
    Some(rest)
}

/// A bias that does not come from a record.
pub(crate) fn bias_fits(bias: &Bias) -> bool {
    bias.taxels.is_none_or(|taxels| levels_fit(&taxels.level) && noise_fits(taxels.noise))
        && bias.bridges.iter().flatten().all(|b| levels_fit(&b.level) && noise_fits(b.noise))
}

/// A level is a fraction of full scale; a difference of two may reach 2.
fn levels_fit(levels: &[f32]) -> bool {
    levels.iter().all(|level| level.abs() <= 2.0)
}

fn noise_fits(noise: f32) -> bool {
    (1e-9..1.0).contains(&noise)
}

fn ranges_fit(ranges: &[Range]) -> bool {
    ranges.iter().all(|[low, high]| low < high) && finite(ranges.as_flattened())
}

fn residuals_fit(residuals: &[f32]) -> bool {
    residuals.iter().all(|residual| (0.0..HUGE).contains(residual))
}
