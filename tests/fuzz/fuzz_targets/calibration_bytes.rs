//! Calibration records as the link or the flash holds them, with a repaired CRC.
#![no_main]

use libfuzzer_sys::fuzz_target;
use taxel::calibration::{Calibration, MAX_BYTES, VERSION};

fuzz_target!(|bytes: &[u8]| {
    let _ = Calibration::from_bytes(bytes);
    let mut record = VERSION.to_le_bytes().to_vec();
    record.extend(bytes);
    record.extend(crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&record).to_le_bytes());
    if let Ok(calibration) = Calibration::from_bytes(&record) {
        let mut buffer = [0; MAX_BYTES];
        let written = calibration.to_bytes(&mut buffer).expect("what was read can be written");
        assert_eq!(Calibration::from_bytes(written), Ok(calibration));
    }
});
