//! The host's words for a scan, and the plan's.

use scan_plan::Settings;
use taxel::wire::message::{Refusal, ScanSetting, ScanSettings};

/// What the plan is made from.
#[must_use]
pub const fn wish(settings: &ScanSettings) -> Settings {
    let ScanSettings { scan_hz, oversampling, settle_ns } = *settings;
    Settings { scan_hz, oversampling, settle_ns }
}

/// What the host is told of a scan.
#[must_use]
pub const fn told(settings: &Settings) -> ScanSettings {
    let Settings { scan_hz, oversampling, settle_ns } = *settings;
    ScanSettings { scan_hz, oversampling, settle_ns }
}

/// What the host is told of a scan that cannot be.
#[must_use]
pub const fn refused(refusal: scan_plan::Refusal) -> Refusal {
    use scan_plan::Refusal::{Oversampling, ScanHz, SettleNs};
    let (setting, low, high) = match refusal {
        ScanHz { low, high } => (ScanSetting::ScanHz, low, high),
        Oversampling { low, high } => (ScanSetting::Oversampling, low, high),
        SettleNs { low, high } => (ScanSetting::SettleNs, low, high),
    };
    Refusal::Scan { setting, low, high }
}
