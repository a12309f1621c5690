//! The frames of a recording, as the finger sent them.

use std::collections::HashMap;
use std::path::Path;

use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::condition::{Health, Signals};
use taxel::estimate::slip::Verdict;
use taxel::estimate::{ContactPoint, Force, NormalContact, Uncertainty};
use taxel::frame::{Fields, Frame, Status};
use taxel::measured::{Measured, NoValue};
use taxel::scan::{SENSORS, TAXELS};
use taxel::units::{Micros, Millimetres, NewtonMillimetres, Newtons};
use taxel_files::frames::{Cell, columns};
use taxel_files::recording::{Header, Recording};
use taxel_files::trace::is_code;
use taxel_files::{FileError, calibration};

/// A recording, frame by frame. Its codes are left out: a recording that has them can be computed again.
pub(crate) struct Recorded {
    recording: Recording,
    places: HashMap<String, usize>,
    fields: Fields,
    /// The calibration that it was recorded with, as a finger keeps it.
    pub(crate) calibration: Option<Vec<u8>>,
}

/// Fields, and a column that stands for each.
const TELLTALES: [(Fields, &str); 8] = [
    (Fields::FORCE, "fz_n"),
    (Fields::POINT, "x_mm"),
    (Fields::TORSION, "torsion_nmm"),
    (Fields::SLIP, "slip_margin"),
    (Fields::CONTACTS, "contact1_x_mm"),
    (Fields::UNCERTAINTY, "misfit"),
    (Fields::SENSORS, "s0_fz_n"),
    (Fields::SIGNALS, "dead"),
];

impl Recorded {
    /// Opens a recording without codes; `None` where it has them, or is a trace.
    pub(crate) fn without_codes(path: &Path) -> Result<Option<Self>, FileError> {
        let recording = match Recording::open(path) {
            Ok(recording) if recording.position("seq").is_some() => recording,
            // Whoever reads traces says what is wrong with it.
            _ => return Ok(None),
        };
        if recording.columns.iter().any(|column| is_code(&column.name)) {
            return Ok(None);
        }
        let names = recording.columns.iter().enumerate();
        let places: HashMap<_, _> = names.map(|(at, column)| (column.name.clone(), at)).collect();
        let there = TELLTALES.iter().filter(|(_, name)| places.contains_key(*name));
        let fields = Fields(there.fold(0, |fields, (field, _)| fields | field.0));
        let missing = columns(fields).into_iter().find(|c| !places.contains_key(&c.name));
        if let Some(missing) = missing {
            return Err(FileError::new(path, "the column is missing")
                .column(missing.name)
                .mend("a recording has all columns of its fields"));
        }
        let text = recording.header.calibration.as_deref();
        let calibration = text.map(|text| calibration::parse(path, text)).transpose()?;
        let record = |calibration: Calibration| {
            let mut buffer = [0; MAX_BYTES];
            calibration.to_bytes(&mut buffer).map(<[u8]>::to_vec).ok()
        };
        let calibration = calibration.and_then(record);
        Ok(Some(Self { recording, places, fields, calibration }))
    }

    pub(crate) fn header(&self) -> &Header {
        &self.recording.header
    }

    pub(crate) fn fields(&self) -> Fields {
        self.fields
    }

    fn frame(&self, row: &[Cell]) -> Frame {
        let row = Row { cells: row, places: &self.places };
        let on = |field| self.fields.contains(field);
        Frame {
            seq: row.whole("seq") as u32,
            time: Micros(row.whole("t_us")),
            status: Status(row.whole("status") as u32),
            codes: None,
            signals: on(Fields::SIGNALS).then(|| row.signals()),
            sensors: on(Fields::SENSORS)
                .then(|| std::array::from_fn(|i| row.force(&format!("s{i}_"), ""))),
            force: on(Fields::FORCE).then(|| row.force("", "")),
            point: on(Fields::POINT).then(|| row.point("", "")),
            slip: on(Fields::SLIP).then(|| row.slip()),
            torsion: on(Fields::TORSION).then(|| row.real("torsion_nmm").map(NewtonMillimetres)),
            contacts: on(Fields::CONTACTS).then(|| row.contacts()),
            uncertainty: on(Fields::UNCERTAINTY).then(|| row.uncertainty()),
        }
    }
}

impl Iterator for Recorded {
    type Item = Result<Frame, FileError>;

    fn next(&mut self) -> Option<Self::Item> {
        let row = self.recording.next()?;
        Some(row.map(|row| self.frame(&row)))
    }
}

struct Row<'r> {
    cells: &'r [Cell],
    places: &'r HashMap<String, usize>,
}

impl Row<'_> {
    fn cell(&self, name: &str) -> Cell {
        self.places.get(name).and_then(|at| self.cells.get(*at)).copied().unwrap_or(Cell::Empty)
    }

    fn whole(&self, name: &str) -> u64 {
        match self.cell(name) {
            Cell::Whole(value) => value,
            _ => 0,
        }
    }

    /// CSV has lost the reason of a value that was withheld: it was not estimated as far as one can tell.
    fn real(&self, name: &str) -> Measured<f32> {
        match self.cell(name) {
            Cell::Real(value) => Ok(value),
            Cell::Withheld(why) => Err(why),
            Cell::Whole(_) | Cell::Empty => Err(NoValue::NotEstimated),
        }
    }

    fn force(&self, stem: &str, of: &str) -> Force {
        let [x, y, z] = ["x", "y", "z"].map(|axis| self.real(&format!("{stem}f{axis}{of}_n")));
        Force { x: x.map(Newtons), y: y.map(Newtons), z: z.map(Newtons) }
    }

    fn point(&self, stem: &str, of: &str) -> Measured<ContactPoint> {
        let at = |axis| self.real(&format!("{stem}{axis}{of}_mm")).map(Millimetres);
        Ok(ContactPoint { x: at("x")?, y: at("y")? })
    }

    fn slip(&self) -> Measured<Verdict> {
        let [margin, friction, grip] =
            ["slip_margin", "friction", "grip_n"].map(|name| self.real(name));
        Ok(Verdict { margin: margin?, friction: friction?, grip: Newtons(grip?) })
    }

    fn contacts(&self) -> Measured<[NormalContact; 2]> {
        let contact = |stem: &str| {
            let normal = Newtons(self.real(&format!("{stem}fz_n"))?);
            Ok(NormalContact { point: self.point(stem, "")?, normal })
        };
        Ok([contact("contact1_")?, contact("contact2_")?])
    }

    /// Without contact there is none of it, for one reason.
    fn uncertainty(&self) -> Measured<Uncertainty> {
        let misfit = self.real("misfit");
        if misfit == Err(NoValue::NoContact) {
            return Err(NoValue::NoContact);
        }
        Ok(Uncertainty { force: self.force("", "_sigma"), point: self.point("", "_sigma"), misfit })
    }

    fn signals(&self) -> Signals {
        // A matrix or a sensor that the finger does not have has empty cells, all of them.
        let all = |names: &mut dyn Iterator<Item = String>| {
            names.map(|name| self.real(&name).ok()).collect::<Option<Vec<f32>>>()
        };
        let taxels = all(&mut (0..TAXELS).map(|k| format!("c_r{}c{}", k / 4, k % 4)));
        let bridge = |i| all(&mut ["x", "y", "z"].into_iter().map(|axis| format!("s{i}_u{axis}")));
        Signals {
            taxels: taxels.and_then(|taxels| taxels.try_into().ok()),
            bridges: std::array::from_fn::<_, SENSORS, _>(|i| bridge(i)?.try_into().ok()),
            health: Health {
                saturated: self.whole("saturated") as u16,
                dead: self.whole("dead") as u16,
                bridge_faults: self.whole("bridge_faults") as u8,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use taxel_files::frames::cells;
    use taxel_files::recording::{Existing, Recorder};

    use super::*;

    #[test]
    fn frames_come_out_of_a_recording_as_they_went_in() {
        let given = |seq| Frame {
            seq,
            time: Micros(1 << 40),
            status: Status::CONTACT,
            codes: None,
            signals: Some(Signals {
                taxels: Some(std::array::from_fn(|k| k as f32 * -1e-3)),
                bridges: [Some([1.0, -2.0, 3.0]), None, None, Some([0.5; 3])],
                health: Health { saturated: 1, dead: 2, bridge_faults: 3 },
            }),
            sensors: Some([Force::none(NoValue::Absent); SENSORS]),
            force: Some(Force {
                x: Ok(Newtons(0.1)),
                y: Err(NoValue::Saturated),
                z: Ok(Newtons(1.5)),
            }),
            point: Some(Ok(ContactPoint { x: Millimetres(1.0), y: Millimetres(-1.0) })),
            slip: Some(Ok(Verdict { margin: 0.4, friction: 0.8, grip: Newtons(2.0) })),
            torsion: Some(Ok(NewtonMillimetres(3.0))),
            contacts: Some(Ok([NormalContact {
                point: ContactPoint { x: Millimetres(2.0), y: Millimetres(0.0) },
                normal: Newtons(0.5),
            }; 2])),
            uncertainty: Some(Ok(Uncertainty {
                force: Force { x: Err(NoValue::NotEstimated), ..Force::known(0.1, 0.02, 0.3) },
                point: Ok(ContactPoint { x: Millimetres(0.06), y: Millimetres(0.07) }),
                misfit: Ok(1.2),
            })),
        };
        let nothing = Frame {
            signals: Some(Signals::default()),
            point: Some(Err(NoValue::NoContact)),
            slip: Some(Err(NoValue::NoContact)),
            torsion: Some(Err(NoValue::NotEstimated)),
            contacts: Some(Err(NoValue::IllConditioned)),
            uncertainty: Some(Err(NoValue::NoContact)),
            ..given(8)
        };
        let frames = [given(7), nothing];
        let fields = Fields(Fields::ALL.0 & !Fields::CODES.0);
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.mcap", "a.parquet"] {
            let path = folder.path().join(name);
            let mut recorder =
                Recorder::create(&path, &Header::default(), &columns(fields), Existing::Keep)
                    .unwrap();
            for frame in &frames {
                let mut row = Vec::new();
                cells(frame, fields, &mut row);
                recorder.write(&row).unwrap();
            }
            recorder.finish().unwrap();
            let recorded = Recorded::without_codes(&path).unwrap().unwrap();
            assert_eq!(recorded.fields(), fields);
            assert_eq!(recorded.map(Result::unwrap).collect::<Vec<_>>(), frames, "{name}");
        }
    }
}
