//! Frames of a recording, as the finger sent them.

use std::path::Path;

use taxel::calibration::{Calibration, MAX_BYTES};
use taxel::frame::{Fields, Frame};
use taxel_files::frames::FrameReader;
use taxel_files::recording::{Header, Recording};
use taxel_files::trace::is_code;
use taxel_files::{FileError, calibration};

/// Iterator over a recording's frames, without codes. A recording with codes can be computed again
/// instead.
pub(crate) struct Recorded {
    recording: Recording,
    reader: FrameReader,
    /// Calibration record of the recording.
    pub(crate) calibration: Option<Vec<u8>>,
}

impl Recorded {
    /// Opens a recording without codes; `None` if it has codes, or is a trace.
    pub(crate) fn without_codes(path: &Path) -> Result<Option<Self>, FileError> {
        let recording = match Recording::open(path) {
            Ok(recording) if recording.position("seq").is_some() => recording,
            // The reader of traces reports what is wrong with the file.
            _ => return Ok(None),
        };
        if recording.columns.iter().any(|column| is_code(&column.name)) {
            return Ok(None);
        }
        let reader = FrameReader::new(&recording.columns).map_err(|missing| {
            FileError::new(path, "the column is missing")
                .column(missing)
                .mend("a recording has all columns of its fields")
        })?;
        let text = recording.header.calibration.as_deref();
        let calibration = text.map(|text| calibration::parse(path, text)).transpose()?;
        let record = |calibration: Calibration| {
            let mut buffer = [0; MAX_BYTES];
            calibration.to_bytes(&mut buffer).map(<[u8]>::to_vec).ok()
        };
        let calibration = calibration.and_then(record);
        Ok(Some(Self { recording, reader, calibration }))
    }

    pub(crate) fn header(&self) -> &Header {
        &self.recording.header
    }

    pub(crate) fn fields(&self) -> Fields {
        self.reader.fields()
    }
}

impl Iterator for Recorded {
    type Item = Result<Frame, FileError>;

    fn next(&mut self) -> Option<Self::Item> {
        let row = self.recording.next()?;
        Some(row.map(|row| self.reader.frame(&row)))
    }
}

#[cfg(test)]
mod tests {
    use taxel::condition::{Health, Signals};
    use taxel::estimate::slip::Verdict;
    use taxel::estimate::{ContactPoint, Force, NormalContact, Uncertainty};
    use taxel::frame::Status;
    use taxel::measured::NoValue;
    use taxel::scan::SENSORS;
    use taxel::units::{Micros, Millimetres, NewtonMillimetres, Newtons};
    use taxel_files::frames::{cells, columns};
    use taxel_files::recording::{Existing, Recorder};

    use super::*;

    #[test]
    fn recorded_frames_read_back_unchanged() {
        let given = |seq| Frame {
            seq,
            time: Micros(1 << 40),
            status: Status::CONTACT,
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
            ..Frame::default()
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
        let fields = given(7).fields();
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
