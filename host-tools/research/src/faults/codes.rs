//! Codes of a scan as one list of channels.

use taxel::scan::{COLS, Codes, Midpoints, SENSORS, TAXELS, TaxelCodes};
use taxel::units::Code;

/// First dark code, after the lit codes.
pub(super) const DARK: usize = TAXELS;
/// First midpoint, four of each sensor.
pub(super) const ARMS: usize = DARK + COLS;
/// The reference channel.
pub(super) const REFERENCE: usize = ARMS + 4 * SENSORS;
/// The thermometer.
pub(super) const THERMOMETER: usize = REFERENCE + 1;
/// Number of channels.
pub(crate) const CHANNELS: usize = THERMOMETER + 1;

/// Code of each channel; zero for a channel that the finger lacks.
pub(crate) type Flat = [u16; CHANNELS];

/// Moves a code by a number of steps, within a range that ends at `top`.
pub(crate) fn shift(code: &mut Code, by: f64, top: u16) {
    code.0 = (f64::from(code.0) + by).round().clamp(0.0, f64::from(top)) as u16;
}

/// Brightens a row of lit codes by a share of its light above the dark codes.
pub(crate) fn brighten(lit: &mut [Code; COLS], dark: &[Code; COLS], share: f64, top: u16) {
    for (code, dark) in lit.iter_mut().zip(dark) {
        shift(code, share * (f64::from(code.0) - f64::from(dark.0)), top);
    }
}

/// Lists the codes of a scan.
pub(crate) fn flat(codes: &Codes) -> Flat {
    let TaxelCodes { lit, dark } = codes.taxels.unwrap_or_default();
    let lit = lit.into_iter().flatten();
    let arms = codes.bridges.iter().flat_map(|midpoints| {
        let Midpoints { a, b, c, d } = midpoints.unwrap_or_default();
        [a, b, c, d]
    });
    let auxiliary = [codes.reference, codes.temperature].map(Option::unwrap_or_default);
    let mut flat = [0; CHANNELS];
    let all = lit.chain(dark).chain(arms).chain(auxiliary);
    flat.iter_mut().zip(all).for_each(|(flat, code)| *flat = code.0);
    flat
}

/// Writes listed codes into those channels that the finger of `like` has.
pub(crate) fn unflat(flat: &Flat, like: &Codes) -> Codes {
    let mut codes = *like;
    if let Some(TaxelCodes { lit, dark }) = &mut codes.taxels {
        let all = lit.as_flattened_mut().iter_mut().chain(dark);
        all.zip(flat).for_each(|(code, flat)| *code = Code(*flat));
    }
    for (midpoints, flat) in codes.bridges.iter_mut().zip(flat[ARMS..].as_chunks::<4>().0) {
        if let Some(midpoints) = midpoints {
            let [a, b, c, d] = flat.map(Code);
            *midpoints = Midpoints { a, b, c, d };
        }
    }
    let write = |code: &mut Option<Code>, k: usize| {
        if let Some(code) = code {
            *code = Code(flat[k]);
        }
    };
    write(&mut codes.reference, REFERENCE);
    write(&mut codes.temperature, THERMOMETER);
    codes
}

#[cfg(test)]
mod tests {
    use super::*;
    use taxel::units::FullScale;

    #[test]
    fn codes_survive_the_list_and_absent_channels_stay_absent() {
        let lit = core::array::from_fn(|r| core::array::from_fn(|c| Code((10 * r + c) as u16)));
        let midpoints = Midpoints { a: Code(1), b: Code(2), c: Code(3), d: Code(4) };
        let codes = Codes {
            full_scale: FullScale::BITS_16,
            taxels: Some(TaxelCodes { lit, dark: [Code(9); COLS] }),
            bridges: [Some(midpoints), None, Some(midpoints), None],
            reference: Some(Code(7)),
            temperature: None,
        };
        assert_eq!(unflat(&flat(&codes), &codes), codes);
        let mut other = flat(&codes);
        other.iter_mut().for_each(|code| *code += 100);
        let other = unflat(&other, &codes);
        assert_eq!((other.bridges[1], other.temperature), (None, None));
        assert_eq!(other.reference, Some(Code(107)));
        assert_eq!(other.taxels.unwrap().lit[3][2], Code(132));
    }
}
