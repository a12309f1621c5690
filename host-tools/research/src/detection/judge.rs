//! Judgement of a faulty run against its sound run.

use taxel::finger::Estimate;
use taxel::frame::Status;
use taxel::scan::TAXELS;

use super::bench::{Phase, Run, WANTED};
use crate::faults::{Fault, RATE_HZ, unflat};
use taxel_calibrate::evaluate::FLAGS;

/// Flags that report a fault of a channel; the first is that of a clipped taxel.
pub(super) const FAULTS: [Status; 5] = [
    Status::SATURATED,
    Status::DEAD_TAXEL,
    Status::BRIDGE_FAULT,
    Status::STUCK_CHANNEL,
    Status::NOISY,
];
/// Returns whether a flag reports a fault of a channel.
pub(crate) fn tells_fault(status: Status) -> bool {
    FAULTS.iter().any(|flag| status.contains(*flag))
}

/// Parts of a frame that are judged.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Frame {
    /// Named channels: 16 taxels, then the sensors.
    pub named: u32,
    /// Whether a flag reports a fault.
    pub fault: bool,
    /// Whether any flag puts the values in doubt, a fault's included.
    pub doubted: bool,
    pub too_warm: bool,
    /// Whether a flag reports another fault than a clipped taxel.
    pub unclipped: bool,
    /// Force in newtons.
    pub force: [Option<f32>; 3],
    pub slides: bool,
    pub warns: bool,
}

impl Frame {
    pub fn of(estimate: &Estimate) -> Self {
        let has = |flag: &Status| estimate.status.contains(*flag);
        let health = &estimate.signals.health;
        let taxels = u32::from(health.saturated | health.dead);
        let force = &estimate.force;
        Self {
            named: taxels | u32::from(health.bridge_faults) << TAXELS,
            fault: tells_fault(estimate.status),
            doubted: FLAGS.iter().any(has),
            too_warm: has(&Status::TEMPERATURE),
            unclipped: FAULTS.iter().skip(1).any(has),
            force: [force.x, force.y, force.z].map(|part| part.ok().map(|newtons| newtons.0)),
            slides: has(&Status::SLIDES),
            warns: has(&Status::SLIP_WARNING),
        }
    }

    /// Difference of the forces in newtons; `None` where neither has a component.
    fn off(&self, sound: &Self) -> Option<f32> {
        let pairs = self.force.iter().zip(&sound.force);
        let both = pairs.filter_map(|(own, sound)| Some(own.as_ref()? - sound.as_ref()?));
        both.fold(None, |sum, d| Some(sum.unwrap_or(0.0) + d * d)).map(f32::sqrt)
    }
}

/// Result of one fault in one run.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Case {
    /// Time from the first changed code to the first frame with a fault's flag, in ms.
    pub flagged_ms: Option<f64>,
    /// Time to the first frame that names the right channel and no other, in ms.
    pub named_ms: Option<f64>,
    /// Whether a frame names a sound channel.
    pub wrong: bool,
    /// Number of frames, and of those without a force or with a flag.
    pub frames: usize,
    pub withheld: usize,
    /// Differences from the sound force in the other frames, in newtons.
    pub errors: Vec<f32>,
    /// Whether a slide or a slip warning is in no sound frame.
    pub slides: bool,
    pub warns: bool,
}

/// Runs a fault; `None` if it changes no code.
pub(super) fn case(run: &Run, phase: Phase, fault: &Fault) -> Option<Case> {
    let [onset, scans] = phase.scans();
    let (mut state, mut estimate) = (run.state(phase), Estimate::NOTHING);
    let mut verdict = Verdict::new(fault);
    for n in onset..onset + scans {
        let (scan, codes, sound) = (run.scans.get(n)?, run.codes.get(n)?, run.frames.get(n)?);
        let faulty = fault.apply(n, codes);
        let mut scan = *scan;
        scan.codes = unflat(&faulty, &scan.codes);
        run.finger.update(&mut estimate, &mut state, &scan, WANTED);
        verdict.add(&Frame::of(&estimate), sound, faulty != *codes);
    }
    verdict.first.map(|_| verdict.case)
}

/// Verdict on a run, frame by frame.
struct Verdict {
    allowed: u32,
    needed: u32,
    thermometer: bool,
    n: usize,
    /// Frame of the first changed code.
    first: Option<usize>,
    case: Case,
}

impl Verdict {
    fn new(fault: &Fault) -> Self {
        Self {
            allowed: fault.allowed(),
            needed: fault.needed(),
            thermometer: fault.of_thermometer(),
            n: 0,
            first: None,
            case: Case::default(),
        }
    }

    /// Adds the frame of a faulty run with that of its sound run.
    fn add(&mut self, frame: &Frame, sound: &Frame, changed: bool) {
        let n = self.n;
        self.n += 1;
        let Some(first) = self.first.or(changed.then_some(n)) else { return };
        self.first = Some(first);
        let ms = || Some(1e3 * (n - first) as f64 / RATE_HZ);
        let case = &mut self.case;
        let too_warm = frame.too_warm && !sound.too_warm;
        if case.flagged_ms.is_none()
            && (frame.fault && !sound.fault || self.thermometer && too_warm)
        {
            case.flagged_ms = ms();
        }
        let named = frame.named & !sound.named;
        let others = named & !self.allowed != 0;
        case.wrong |= others;
        let right = named.count_ones() >= self.needed.max(1) && !others;
        if case.named_ms.is_none() && (right || self.thermometer && too_warm) {
            case.named_ms = ms();
        }
        case.frames += 1;
        if frame.doubted || frame.force[2].is_none() {
            case.withheld += 1;
        } else {
            case.errors.extend(frame.off(sound));
        }
        case.slides |= frame.slides && !sound.slides;
        case.warns |= frame.warns && !sound.warns;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOUND: Frame = Frame {
        named: 0,
        fault: false,
        doubted: false,
        too_warm: false,
        unclipped: false,
        force: [Some(0.0), Some(0.0), Some(1.0)],
        slides: false,
        warns: false,
    };

    /// Verdict on frames of a fault that may be named by `allowed`, at least `needed` of them.
    fn judged([allowed, needed]: [u32; 2], frames: &[Frame]) -> Case {
        let mut verdict = Verdict {
            allowed,
            needed,
            thermometer: false,
            n: 0,
            first: None,
            case: Case::default(),
        };
        // The first frame has the sound codes.
        verdict.add(&SOUND, &SOUND, false);
        frames.iter().for_each(|frame| verdict.add(frame, &SOUND, true));
        verdict.case
    }

    fn names(named: u32) -> Frame {
        Frame { named, fault: true, doubted: true, ..SOUND }
    }

    #[test]
    fn unnamed_fault_counts_its_error() {
        let off = Frame { force: [Some(0.3), Some(0.4), Some(1.0)], ..SOUND };
        let case = judged([1 << 5, 1], &[SOUND, off, off]);
        assert_eq!((case.named_ms, case.flagged_ms, case.wrong), (None, None, false));
        assert_eq!((case.frames, case.withheld, case.errors.len()), (3, 0, 3));
        assert!((case.errors[1] - 0.5).abs() < 1e-6);
    }

    #[test]
    fn named_fault_has_the_time_of_its_frame() {
        let case = judged([1 << 5, 1], &[SOUND, SOUND, names(1 << 5), names(1 << 5)]);
        assert_eq!((case.named_ms, case.wrong, case.withheld), (Some(0.5), false, 2));
        assert_eq!(judged([1 << 5, 1], &[names(1 << 5)]).named_ms, Some(0.0));
    }

    #[test]
    fn wrong_channel_is_flagged_but_not_named() {
        for named in [1 << 6, 1 << 6 | 1 << 5, 1 << 17] {
            let case = judged([1 << 5, 1], &[names(named)]);
            assert_eq!((case.named_ms, case.flagged_ms, case.wrong), (None, Some(0.0), true));
        }
        // A flag that names nothing names no wrong channel either.
        let case = judged([1 << 5, 1], &[names(0)]);
        assert_eq!((case.named_ms, case.flagged_ms, case.wrong), (None, Some(0.0), false));
    }

    #[test]
    fn row_is_named_by_half_of_its_taxels() {
        assert_eq!(judged([0xf0, 2], &[names(1 << 5)]).named_ms, None);
        assert_eq!(judged([0xf0, 2], &[names(0x30)]).named_ms, Some(0.0));
    }

    #[test]
    fn withheld_or_doubted_force_has_no_error() {
        let none = Frame { force: [None; 3], ..SOUND };
        let doubted = Frame { doubted: true, force: [Some(9.0); 3], ..SOUND };
        let case = judged([1, 1], &[none, doubted, SOUND]);
        assert_eq!((case.frames, case.withheld), (3, 2));
        assert_eq!(case.errors, [0.0]);
    }

    #[test]
    fn slide_of_the_sound_run_is_not_false() {
        let slides = Frame { slides: true, ..SOUND };
        assert!(judged([1, 1], &[slides]).slides);
        let mut verdict = Verdict {
            allowed: 1,
            needed: 1,
            thermometer: false,
            n: 0,
            first: None,
            case: Case::default(),
        };
        verdict.add(&slides, &slides, true);
        assert!(!verdict.case.slides);
    }
}
