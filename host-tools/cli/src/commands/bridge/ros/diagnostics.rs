//! Condition of a finger and its link as a ROS 2 message.

use std::time::Duration;

use serde::Serialize;
use taxel::frame::Status;
use taxel::frame::schema::{BITS, Kind};

use super::super::finger::Health;
use super::{Header, Type, cdr, header};

/// `diagnostic_msgs/msg/DiagnosticArray`.
pub const DIAGNOSTICS: Type = Type {
    name: "diagnostic_msgs::msg::dds_::DiagnosticArray_",
    hash: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
};

/// Flags that tell about the contact, not about the finger.
const OF_THE_CONTACT: Status = Status::SLIDES.union(Status::SLIP_WARNING).union(Status::NOT_SINGLE);

/// `DiagnosticStatus.level`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Level {
    Ok = 0,
    Warn = 1,
    Error = 2,
}

#[derive(Serialize)]
struct DiagnosticArray<'n> {
    header: Header<'n>,
    status: Vec<DiagnosticStatus<'n>>,
}

#[derive(Serialize)]
struct DiagnosticStatus<'n> {
    level: u8,
    name: String,
    message: String,
    hardware_id: &'n str,
    values: Vec<KeyValue>,
}

#[derive(Serialize)]
struct KeyValue {
    key: &'static str,
    value: String,
}

/// Encodes the condition of a finger. A fault or a broken link is an error, a warning or a lost
/// frame a warning.
pub fn diagnostic_array(health: &Health, at: Duration, node: &str, serial: &str) -> Vec<u8> {
    let (level, message) = verdict(health);
    let value = |key, value: &dyn std::fmt::Display| KeyValue { key, value: value.to_string() };
    let values = vec![
        value("rate_hz", &format_args!("{:.1}", health.rate_hz)),
        value("flags", &names(health.status)),
        value("frames", &health.frames),
        value("lost", &health.lost),
        value("dropped_by_the_bridge", &health.overflow),
        value("bad_packets", &health.bad_packets),
        value("connections", &health.connections),
    ];
    let status = DiagnosticStatus {
        level: level as u8,
        name: format!("{}: finger", node.trim_start_matches('/')),
        message,
        hardware_id: serial,
        values,
    };
    cdr(&DiagnosticArray { header: header(at, ""), status: vec![status] })
}

fn verdict(health: &Health) -> (Level, String) {
    if let Some(problem) = health.problem {
        return (Level::Error, problem.to_owned());
    }
    let told = BITS.iter().filter(|bit| health.status.contains(bit.status));
    let told = told.filter(|bit| !OF_THE_CONTACT.contains(bit.status));
    let told = told.filter_map(|bit| match bit.kind {
        Kind::Fault => Some((Level::Error, bit.title)),
        Kind::Warning => Some((Level::Warn, bit.title)),
        Kind::Good | Kind::Estimator => None,
    });
    let mut told: Vec<_> = told.collect();
    if health.newly_lost > 0 {
        told.push((Level::Warn, "Frames were lost on the way"));
    }
    told.sort_by_key(|(level, _)| std::cmp::Reverse(*level));
    match told.first() {
        None => (Level::Ok, "sound".to_owned()),
        Some((level, _)) => {
            let titles: Vec<_> = told.iter().map(|(_, title)| *title).collect();
            (*level, titles.join("; "))
        }
    }
}

/// Lists the flags by name, without the estimators that ran.
fn names(status: Status) -> String {
    let flags = BITS.iter().filter(|bit| bit.kind != Kind::Estimator);
    let set = flags.filter(|bit| status.contains(bit.status));
    set.map(|bit| bit.name).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn level(status: Status) -> Level {
        verdict(&Health { status, ..Health::default() }).0
    }

    #[test]
    fn level_follows_the_worst_flag_of_the_finger() {
        assert_eq!(level(Status::CONTACT | Status::BIASED | Status::RAN_NET), Level::Ok);
        assert_eq!(level(Status::SLIDES | Status::SLIP_WARNING), Level::Ok);
        assert_eq!(level(Status::UNCALIBRATED), Level::Warn);
        assert_eq!(level(Status::UNCALIBRATED | Status::DEAD_TAXEL), Level::Error);
        let lost = Health { newly_lost: 1, ..Health::default() };
        assert_eq!(verdict(&lost), (Level::Warn, "Frames were lost on the way".to_owned()));
        let gone = Health { problem: Some("unplugged"), ..Health::default() };
        assert_eq!(verdict(&gone), (Level::Error, "unplugged".to_owned()));
    }
}
