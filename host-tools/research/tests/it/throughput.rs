//! Checks the floors of reading, writing and replaying. Only optimised builds have them: `cargo
//! xtask test --profile nightly` runs this file in one.

#[cfg(not(debug_assertions))]
mod nightly {
    use std::sync::atomic::AtomicBool;

    use taxel_research::Waiting;
    use taxel_research::throughput::{self, FLOORS, PLAINLY, Stage};

    /// Measurements until one is fast enough. Other programs slow some of them down, but slow code
    /// is slow in all.
    const TRIES: usize = 5;

    fn us_per_frame(stages: &[Stage], name: &str) -> f64 {
        stages.iter().find(|stage| stage.name == name).unwrap().us_per_frame
    }

    /// Lists the stages below their floors.
    fn too_slow(stages: &[Stage]) -> Vec<String> {
        let found = FLOORS.map(|(name, floor)| {
            let other = us_per_frame(stages, &format!("{name}{PLAINLY}"));
            (name, floor, other / us_per_frame(stages, name))
        });
        let below = found.into_iter().filter(|(_, floor, ratio)| ratio < floor);
        below.map(|(name, floor, ratio)| format!("{name}: {ratio:.2}, at least {floor}")).collect()
    }

    #[test]
    fn traces_and_frames_have_their_speed() {
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
