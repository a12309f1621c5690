//! Checks the floors of reading and replaying. Only optimised builds have them: `cargo xtask test
//! --profile nightly` runs this file in one.

#[cfg(not(debug_assertions))]
mod nightly {
    use std::sync::atomic::AtomicBool;

    use taxel_research::Waiting;
    use taxel_research::throughput::{self, FLOORS, PLAIN, Stage};

    const TABLE: &str = include_str!("../../../../docs/images/throughput.csv");
    /// Measurements until one is fast enough. Other programs slow some of them down, but slow code
    /// is slow in all.
    const TRIES: usize = 5;

    fn us_per_frame(stages: &[Stage], name: &str) -> f64 {
        stages.iter().find(|stage| stage.name == name).unwrap().us_per_frame
    }

    /// Microseconds per frame in the committed table.
    fn committed(name: &str) -> f64 {
        let mut records = csv::Reader::from_reader(TABLE.as_bytes()).into_records();
        let record = records.find_map(|record| record.ok().filter(|record| &record[0] == name));
        record.unwrap()[2].parse().unwrap()
    }

    /// Lists the stages below their floors.
    ///
    /// The plain reader tells how much slower this machine is now than the one that drew the table.
    fn too_slow(stages: &[Stage]) -> Vec<String> {
        let slower = (us_per_frame(stages, PLAIN) / committed(PLAIN)).max(1.0);
        let rates = FLOORS.map(|(name, floor)| (name, floor, 1e6 / us_per_frame(stages, name)));
        let below = rates.into_iter().filter(|(_, floor, rate)| rate * slower < *floor);
        let told = |(name, floor, rate)| {
            format!(
                "{name}: {rate:.0} a second, at least {floor}, on a machine {slower:.2} times slower"
            )
        };
        below.map(told).collect()
    }

    #[test]
    fn traces_are_read_and_replayed_at_their_floors() {
        let waiting = Waiting { progress: &|_, _| (), stop: &AtomicBool::new(false) };
        let mut below = Vec::new();
        for _ in 0..TRIES {
            below = too_slow(&throughput::measure(waiting).unwrap().stages);
            if below.is_empty() {
                return;
            }
        }
        panic!("{below:#?}");
    }
}
