//! Helpers for the tests of both chips.

use std::ops::Range;

use taxel::scan::ScanSettings;

/// Stretch of time.
pub type Span = Range<u64>;

/// Grid over all settings that a user may ask for; many of them are refused.
pub fn grid(oversamplings: &'static [u16]) -> impl Iterator<Item = ScanSettings> {
    let rates = (150..=8000).step_by(97).chain([292, 293, 500, 518, 519, 1000, 2000, 4000, 5000]);
    rates.flat_map(move |scan_hz| {
        oversamplings.iter().flat_map(move |oversampling| {
            (17_400..60_000).step_by(1300).map(move |settle_ns| ScanSettings {
                scan_hz,
                oversampling: *oversampling,
                settle_ns,
            })
        })
    })
}

/// Whether any two spans overlap when all repeat after `period`.
pub fn overlaps(spans: &[Span], period: u64) -> bool {
    let mut all: Vec<Span> = spans
        .iter()
        .flat_map(|span| [span.clone(), span.start + period..span.end + period])
        .collect();
    all.sort_by_key(|span| span.start);
    all.windows(2).any(|pair| pair[0].end > pair[1].start)
}
