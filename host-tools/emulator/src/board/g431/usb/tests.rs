//! Tests of the USB device by the sequences of RM0440 §45: registers on one side, the bus on the
//! other.

use super::*;

const EP0: u32 = 0x00;
const EP1: u32 = 0x04;

/// Bits of an endpoint's register (RM0440 §45.6.2).
const CTR_RX: u32 = 1 << 15;
const DTOG_RX: u32 = 1 << 14;
const SETUP: u32 = 1 << 11;
const CONTROL: u32 = 1 << 9;
const CTR_TX: u32 = 1 << 7;
const DTOG_TX: u32 = 1 << 6;
const RX: [u32; 4] = [0, 1 << 12, 2 << 12, 3 << 12];
const TX: [u32; 4] = [0, 1 << 4, 2 << 4, 3 << 4];
const STALL: usize = 1;
const NAK: usize = 2;
const VALID: usize = 3;

const RESETM: u32 = 1 << 10;
const CTRM: u32 = 1 << 15;

/// Addresses of endpoint 0's and 1's buffers, behind a table of eight entries.
const BUFFERS: [[u32; 2]; 2] = [[0x40, 0x80], [0xc0, 0x100]];

fn write(usb: &mut Usb, offset: u32, value: u32) {
    usb.write(offset, value, true, micros(100)).unwrap();
}

fn read(usb: &Usb, offset: u32) -> u32 {
    usb.read(offset, 0).unwrap()
}

/// Device that was reset on the bus, with a control endpoint 0 and a bulk endpoint 1.
fn device() -> Usb {
    let mut usb = Usb::default();
    usb.write(CNTR, 1, true, 0).unwrap();
    usb.write(CNTR, CTRM | RESETM, true, micros(1)).unwrap();
    write(&mut usb, BCDR, PULL_UP);
    assert!(usb.is_attached());
    usb.bus_reset();
    write(&mut usb, ISTR, !RESET);
    for (i, [tx, rx]) in BUFFERS.into_iter().enumerate() {
        // ADDR_TX, COUNT_TX, ADDR_RX; COUNT_RX: two blocks of 32 bytes.
        for (at, value) in [tx, 0, rx, 1 << 15 | 1 << 10].into_iter().enumerate() {
            usb.write_memory(8 * i as u32 + 2 * at as u32, 2, value).unwrap();
        }
    }
    write(&mut usb, EP0, CONTROL | RX[VALID] | TX[NAK]);
    // Bulk, endpoint 1.
    write(&mut usb, EP1, 1 | RX[VALID] | TX[NAK]);
    write(&mut usb, DADDR, 0x80 | 5);
    usb
}

#[test]
fn transceiver_needs_its_start_up_time() {
    let mut usb = Usb::default();
    let off = usb.write(CNTR, 2, true, 0).unwrap_err();
    assert!(off.contains("before the transceiver has started"), "{off}");
    let mut usb = Usb::default();
    usb.write(CNTR, 1, true, micros(7)).unwrap();
    let early = usb.write(CNTR, 0, true, micros(8) - 1).unwrap_err();
    assert!(early.contains("before the transceiver has started"), "{early}");
    usb.write(CNTR, 0, true, micros(8)).unwrap();
    let unclocked = usb.write(CNTR, CTRM, false, micros(9)).unwrap_err();
    assert!(unclocked.contains("without a clock of 48 MHz"), "{unclocked}");
}

#[test]
fn ones_toggle_states_and_zeros_clear_flags() {
    let mut usb = device();
    let endpoint = |usb: &Usb| read(usb, EP1);
    assert_eq!(endpoint(&usb), 1 | RX[VALID] | TX[NAK]);
    // Ones toggle: VALID to STALL, NAK to VALID, and both data toggles.
    write(&mut usb, EP1, 1 | (RX[VALID] ^ RX[STALL]) | (TX[NAK] ^ TX[VALID]) | DTOG_RX | DTOG_TX);
    assert_eq!(endpoint(&usb), 1 | RX[STALL] | TX[VALID] | DTOG_RX | DTOG_TX);
    // Zeros leave them.
    write(&mut usb, EP1, 1);
    assert_eq!(endpoint(&usb), 1 | RX[STALL] | TX[VALID] | DTOG_RX | DTOG_TX);

    // CTR stays with a one, and is cleared by a zero; ISTR tells endpoint and direction.
    let mut usb = device();
    assert_eq!(usb.out(5, 1, false, &[1]), Ok(Answer::Ack));
    assert_eq!(read(&usb, ISTR) & 0x801f, 0x8000 | 1 << 4 | 1);
    assert!(usb.interrupt());
    write(&mut usb, EP1, 1 | CTR_RX | CTR_TX);
    assert_eq!(endpoint(&usb) & CTR_RX, CTR_RX);
    // A one does not set it.
    assert_eq!(endpoint(&usb) & CTR_TX, 0);
    write(&mut usb, EP1, 1 | CTR_TX);
    assert_eq!((endpoint(&usb) & CTR_RX, read(&usb, ISTR) & 0x8000), (0, 0));
    assert!(!usb.interrupt());
}

#[test]
fn setup_packet_goes_to_its_buffer() {
    let mut usb = device();
    let setup = [0x80, 6, 0, 1, 0, 0, 18, 0];
    assert_eq!(usb.setup(5, setup), Ok(Answer::Ack));
    let ep0 = read(&usb, EP0);
    assert_eq!(ep0 & (CTR_RX | SETUP | RX[3] | TX[3]), CTR_RX | SETUP | RX[NAK] | TX[NAK]);
    // Data after a SETUP begin with DATA1, in both directions.
    assert_eq!(ep0 & (DTOG_RX | DTOG_TX), DTOG_RX | DTOG_TX);
    // COUNT_RX keeps the size of the buffer above the number of bytes.
    assert_eq!(usb.read_memory(6, 2), Ok(1 << 15 | 1 << 10 | 8));
    let bytes: Vec<u8> =
        (0..8).map(|i| usb.read_memory(BUFFERS[0][1] + i, 1).unwrap() as u8).collect();
    assert_eq!(bytes, setup);
    // Another endpoint does not take SETUPs, and another address does not answer.
    assert_eq!(usb.setup(6, setup), Ok(Answer::Silence));
}

#[test]
fn in_data_are_sent_once_with_alternating_toggles() {
    let mut usb = device();
    assert_eq!(usb.take(5, 1), Ok(Answer::Nak));
    for data1 in [false, true, false] {
        usb.write_memory(BUFFERS[1][0], 2, 0x2211).unwrap();
        usb.write_memory(8 + 2, 2, 2).unwrap();
        let state = read(&usb, EP1) & TX[3];
        write(&mut usb, EP1, 1 | CTR_RX | (state ^ TX[VALID]));
        assert_eq!(usb.take(5, 1), Ok(Answer::Data(data1, vec![0x11, 0x22])));
        // The endpoint is NAK until the program makes it valid again.
        assert_eq!(read(&usb, EP1) & (CTR_TX | TX[3]), CTR_TX | TX[NAK]);
        assert_eq!(usb.take(5, 1), Ok(Answer::Nak));
        assert_eq!(read(&usb, ISTR) & 0x801f, 0x8001);
        write(&mut usb, EP1, 1 | CTR_RX);
    }
}

#[test]
fn repeated_out_packet_is_acknowledged_and_dropped() {
    let mut usb = device();
    assert_eq!(usb.out(5, 1, false, &[7, 8, 9]), Ok(Answer::Ack));
    assert_eq!(read(&usb, EP1) & (DTOG_RX | RX[3]), DTOG_RX | RX[NAK]);
    assert_eq!(usb.out(5, 1, true, &[1]), Ok(Answer::Nak));
    write(&mut usb, EP1, 1 | (RX[NAK] ^ RX[VALID]));
    assert_eq!(read(&usb, EP1) & CTR_RX, 0);
    assert_eq!(usb.out(5, 1, false, &[1, 1, 1]), Ok(Answer::Ack));
    assert_eq!(read(&usb, EP1) & CTR_RX, 0);
    assert_eq!(usb.read_memory(BUFFERS[1][1], 2), Ok(0x0807));
    assert_eq!(usb.out(5, 1, true, &[2]), Ok(Answer::Ack));
    assert_eq!(read(&usb, EP1) & (CTR_RX | DTOG_RX), CTR_RX);
}

#[test]
fn stalled_and_disabled_endpoints_say_so() {
    let mut usb = device();
    write(&mut usb, EP1, 1 | (RX[VALID] ^ RX[STALL]) | (TX[NAK] ^ TX[STALL]));
    assert_eq!(usb.out(5, 1, false, &[1]), Ok(Answer::Stall));
    assert_eq!(usb.take(5, 1), Ok(Answer::Stall));
    write(&mut usb, EP1, 1 | RX[STALL] | TX[STALL]);
    assert_eq!(usb.out(5, 1, false, &[1]), Ok(Answer::Silence));
    // Isochronous
    assert!(usb.write(EP1, 1 | 2 << 9, true, 0).unwrap_err().contains("isochronous"));
}

#[test]
fn buffers_must_lie_in_the_packet_memory() {
    // 65 bytes exceed two blocks.
    let mut usb = device();
    let long = usb.out(5, 1, false, &[0; 65]).unwrap_err();
    assert!(long.contains("a packet of 65 bytes exceeds its buffer of 64"), "{long}");
    // A buffer that begins four bytes before the end of 1 KB.
    let mut usb = device();
    usb.write_memory(8 + 4, 2, 0x3fc).unwrap();
    let beyond = usb.out(5, 1, false, &[0; 8]).unwrap_err();
    assert!(beyond.contains("beyond the packet memory"), "{beyond}");
    // A table whose second entry is behind the memory, and one that is not on eight bytes.
    let mut usb = device();
    write(&mut usb, BTABLE, 0x3f8);
    let table = usb.out(5, 1, false, &[0]).unwrap_err();
    assert!(table.contains("(BTABLE)"), "{table}");
    assert!(usb.write(BTABLE, 4, true, 0).is_err());
    // The memory has 16 bits.
    assert!(usb.write_memory(0, 4, 0).unwrap_err().contains("16 bits"));
}

#[test]
fn table_may_lie_anywhere_in_the_memory() {
    let mut usb = device();
    for at in 0..16 {
        let byte = usb.read_memory(at, 1).unwrap();
        usb.write_memory(0x200 + at, 1, byte).unwrap();
        usb.write_memory(at, 1, 0).unwrap();
    }
    write(&mut usb, BTABLE, 0x200);
    assert_eq!(usb.out(5, 1, false, &[3, 4]), Ok(Answer::Ack));
    assert_eq!(usb.read_memory(BUFFERS[1][1], 2), Ok(0x0403));
    assert_eq!(usb.read_memory(0x200 + 8 + 6, 2), Ok(1 << 15 | 1 << 10 | 2));
}

#[test]
fn reset_clears_endpoints_and_address() {
    for forced in [false, true] {
        let mut usb = device();
        if forced {
            // FRES
            write(&mut usb, CNTR, CTRM | RESETM | 1);
        } else {
            usb.bus_reset();
        }
        assert_eq!([EP0, EP1, DADDR].map(|register| read(&usb, register)), [0; 3]);
        assert_eq!(read(&usb, ISTR), RESET);
        assert!(usb.interrupt());
        assert_eq!(usb.is_attached(), !forced);
        // A zero clears the flag, ones keep it.
        write(&mut usb, ISTR, u32::MAX);
        assert_eq!(read(&usb, ISTR), RESET);
        write(&mut usb, ISTR, !RESET);
        assert_eq!(read(&usb, ISTR), 0);
    }
}

#[test]
fn suspend_and_wake_set_their_flags() {
    let mut usb = device();
    usb.suspend(true);
    assert_eq!(read(&usb, ISTR), SUSP);
    assert!(!usb.interrupt());
    // SUSPM
    write(&mut usb, CNTR, SUSP);
    assert!(usb.interrupt());
    write(&mut usb, ISTR, !SUSP);
    usb.suspend(false);
    assert_eq!(read(&usb, ISTR), WKUP);
}
