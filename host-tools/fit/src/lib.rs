//! Calibration: from recordings to a calibration record.
