//! Tests of the OTG core by the device sequences of RM0383 §22.17: registers on one side, the bus
//! on the other.

use super::*;
use crate::board::usb::{Answer, Device};

/// Registers of endpoint `i`: control, interrupts, size; FIFO level of an IN endpoint.
const fn diepctl(i: u32) -> u32 {
    IN + 0x20 * i
}

const fn doepctl(i: u32) -> u32 {
    OUT + 0x20 * i
}

const INT: u32 = 0x08;
const TSIZ: u32 = 0x10;
const DTXFSTS: u32 = 0x18;

/// Packet count of one, in DIEPTSIZ.
const ONE: u32 = 1 << 19;

fn write(otg: &mut Otg, offset: u32, value: u32) {
    otg.write(offset, value, true).unwrap();
}

fn read(otg: &mut Otg, offset: u32) -> u32 {
    otg.read(offset, 0).unwrap()
}

/// Core as a device that was reset and enumerated, with a bulk endpoint 1 in each direction.
fn device() -> Otg {
    let mut otg = Otg::default();
    // FDMOD, TRDT; full speed; PWRDWN, NOVBUSSENS.
    write(&mut otg, GUSBCFG, 1 << 30 | 6 << 10 | 0x1440 & 0x40);
    write(&mut otg, GAHBCFG, 1);
    write(&mut otg, DCFG, 0x0220_0003);
    write(&mut otg, GCCFG, 1 << 21 | 1 << 16);
    assert!(otg.is_attached());
    // Receive FIFO of 64 words, then those of endpoints 0 and 1.
    write(&mut otg, GRXFSIZ, 64);
    write(&mut otg, DIEPTXF0, 16 << 16 | 64);
    write(&mut otg, DIEPTXF1, 16 << 16 | 80);
    otg.bus_reset();
    otg.bus_reset_over();
    assert_eq!(read(&mut otg, GINTSTS) & (USBRST | ENUMDNE), USBRST | ENUMDNE);
    write(&mut otg, GINTSTS, USBRST | ENUMDNE);
    assert_eq!(read(&mut otg, GINTSTS) & (USBRST | ENUMDNE), 0);
    write(&mut otg, GINTMSK, RXFLVL | IEPINT | OEPINT);
    write(&mut otg, DIEPMSK, XFRC);
    write(&mut otg, DOEPMSK, XFRC | STUP);
    write(&mut otg, DAINTMSK, 0x3_0003);
    // Bulk of 64 bytes, FIFO 1.
    write(&mut otg, diepctl(1), SD0PID | 1 << 22 | 2 << 18 | USBAEP | 64);
    write(&mut otg, doepctl(1), SD0PID | 2 << 18 | USBAEP | 64);
    otg
}

/// Starts a transfer of one packet of `bytes` bytes on IN endpoint 1.
fn send(otg: &mut Otg, bytes: u32) {
    write(otg, diepctl(1) + TSIZ, ONE | bytes);
    let ctl = read(otg, diepctl(1));
    write(otg, diepctl(1), ctl & !NAKSTS | EPENA | CNAK);
}

#[test]
fn device_mode_and_clock_come_first() {
    let mut otg = Otg::default();
    assert!(otg.write(GUSBCFG, 0x1440, true).unwrap_err().contains("(FDMOD)"));
    assert!(otg.write(GCCFG, 1 << 16, false).unwrap_err().contains("48 MHz"));
    assert!(otg.write(DCFG, 0, true).unwrap_err().contains("(DSPD)"));
    // Without the transceiver, and soft-disconnected.
    assert!(!otg.is_attached());
    let mut otg = device();
    write(&mut otg, DCTL, 2);
    assert!(!otg.is_attached());
}

#[test]
fn fifos_must_fit_beside_each_other() {
    let mut otg = device();
    // 16 words at 310 of 320, and eight words.
    assert!(otg.write(DIEPTXF1, 16 << 16 | 310, true).unwrap_err().contains("does not fit"));
    assert!(otg.write(DIEPTXF1, 8 << 16 | 80, true).unwrap_err().contains("does not fit"));
    // A FIFO within the one before is noticed when the endpoint sends; a gap does no harm.
    for (start, fits) in [(78, false), (82, true)] {
        let mut otg = device();
        write(&mut otg, DIEPTXF1, 16 << 16 | start);
        send(&mut otg, 4);
        write(&mut otg, 2 * FIFO, 0x0403_0201);
        let sent = otg.take(0, 1);
        assert_eq!(sent.is_ok(), fits, "{sent:?}");
        if let Err(inside) = sent {
            assert!(inside.contains("a FIFO begins at 78, the one before ends at 80"), "{inside}");
        }
    }
    // So is a wrong turnaround time.
    let mut otg = device();
    write(&mut otg, GUSBCFG, 1 << 30 | 9 << 10);
    send(&mut otg, 4);
    write(&mut otg, 2 * FIFO, 0);
    assert!(otg.take(0, 1).unwrap_err().contains("(TRDT)"));
}

#[test]
fn in_packet_waits_for_its_words_and_its_enable() {
    let mut otg = device();
    assert_eq!(otg.take(0, 1), Ok(Answer::Nak));
    // No words without a transfer.
    assert!(otg.write(2 * FIFO, 0, true).unwrap_err().contains("outside a transfer"));
    send(&mut otg, 6);
    assert_eq!(otg.take(0, 1), Ok(Answer::Nak));
    write(&mut otg, 2 * FIFO, 0x0403_0201);
    assert_eq!(read(&mut otg, diepctl(1) + DTXFSTS), 15);
    assert_eq!(otg.take(0, 1), Ok(Answer::Nak));
    write(&mut otg, 2 * FIFO, 0x0605);
    assert!(otg.write(2 * FIFO, 0, true).unwrap_err().contains("outside a transfer"));
    assert_eq!(otg.take(0, 1), Ok(Answer::Data(false, vec![1, 2, 3, 4, 5, 6])));
    // XFRC; the endpoint is off again, its sizes are zero and its FIFO empty.
    assert_eq!(read(&mut otg, diepctl(1) + INT) & (XFRC | TXFE), XFRC | TXFE);
    assert_eq!(read(&mut otg, DAINT), 1 << 1);
    assert_eq!(read(&mut otg, GINTSTS) & IEPINT, IEPINT);
    assert!(otg.interrupt());
    assert_eq!(read(&mut otg, diepctl(1)) & EPENA, 0);
    assert_eq!(read(&mut otg, diepctl(1) + TSIZ), 0);
    assert_eq!(read(&mut otg, diepctl(1) + DTXFSTS), 16);
    // A one clears the flag.
    write(&mut otg, diepctl(1) + INT, XFRC);
    assert_eq!((read(&mut otg, DAINT), otg.interrupt()), (0, false));
    // The next packet has DATA1; SD0PID goes back to DATA0.
    for (toggle, data1) in [(0, true), (SD0PID, false), (SODDFRM, true)] {
        send(&mut otg, 0);
        let ctl = read(&mut otg, diepctl(1));
        write(&mut otg, diepctl(1), ctl & !NAKSTS | toggle);
        assert_eq!(otg.take(0, 1), Ok(Answer::Data(data1, vec![])));
    }
}

#[test]
fn full_fifo_takes_no_more_words() {
    let mut otg = device();
    write(&mut otg, diepctl(1) + TSIZ, (2 * ONE) | 128);
    let ctl = read(&mut otg, diepctl(1));
    write(&mut otg, diepctl(1), ctl | EPENA | CNAK);
    for word in 0..16 {
        write(&mut otg, 2 * FIFO, word);
    }
    assert_eq!(read(&mut otg, diepctl(1) + DTXFSTS), 0);
    assert!(otg.write(2 * FIFO, 0, true).unwrap_err().contains("the FIFO is full"));
    // TXFFLSH of FIFO 1.
    write(&mut otg, GRSTCTL, 1 << 6 | 1 << 5);
    assert_eq!(read(&mut otg, diepctl(1) + DTXFSTS), 16);
}

#[test]
fn setup_packet_comes_through_the_receive_fifo() {
    let mut otg = device();
    assert_eq!(otg.setup(0, [0x80, 6, 0, 1, 0, 0, 18, 0]), Ok(Answer::Ack));
    assert_eq!(read(&mut otg, GINTSTS) & (RXFLVL | OEPINT), RXFLVL);
    // PKTSTS, BCNT and EPNUM of the data; then the end of the SETUP, which raises STUP.
    assert_eq!(read(&mut otg, GRXSTSP), SETUP_DATA << 17 | 8 << 4);
    assert!(otg.read(GRXSTSP, 0).unwrap_err().contains("before all words"));
    assert_eq!([read(&mut otg, FIFO), read(&mut otg, FIFO)], [0x0100_0680, 0x0012_0000]);
    assert!(otg.read(FIFO, 0).unwrap_err().contains("more words than the packet has"));
    assert_eq!(read(&mut otg, GRXSTSP), SETUP_DONE << 17);
    assert_eq!(read(&mut otg, doepctl(0) + INT), STUP);
    assert_eq!(read(&mut otg, GINTSTS) & (RXFLVL | OEPINT), OEPINT);
    assert!(otg.read(GRXSTSP, 0).unwrap_err().contains("the FIFO is empty"));
    // Both directions answer NAK, and data begin with DATA1.
    assert_eq!(read(&mut otg, diepctl(0)) & NAKSTS, NAKSTS);
    write(&mut otg, diepctl(0) + TSIZ, ONE | 1);
    write(&mut otg, diepctl(0), EPENA | CNAK);
    write(&mut otg, FIFO, 0x5a);
    assert_eq!(otg.take(0, 0), Ok(Answer::Data(true, vec![0x5a])));
}

#[test]
fn out_packet_needs_cnak_and_alternates_its_toggle() {
    let mut otg = device();
    assert_eq!(otg.out(0, 1, false, &[1, 2, 3]), Ok(Answer::Nak));
    let clear = |otg: &mut Otg| {
        write(otg, doepctl(1) + TSIZ, ONE | 64);
        let ctl = read(otg, doepctl(1));
        write(otg, doepctl(1), ctl & !NAKSTS | EPENA | CNAK);
    };
    clear(&mut otg);
    assert_eq!(otg.out(0, 1, false, &[1, 2, 3]), Ok(Answer::Ack));
    // One packet was asked for.
    assert_eq!(otg.out(0, 1, true, &[4]), Ok(Answer::Nak));
    assert_eq!(read(&mut otg, doepctl(1) + TSIZ), 61);
    assert_eq!(read(&mut otg, GRXSTSP), OUT_DATA << 17 | 3 << 4 | 1);
    assert_eq!(read(&mut otg, FIFO), 0x0003_0201);
    assert_eq!(read(&mut otg, GRXSTSP), OUT_DONE << 17 | 1);
    assert_eq!(read(&mut otg, DAINT), 1 << 17);
    // A repeated packet is acknowledged and dropped.
    clear(&mut otg);
    assert_eq!(otg.out(0, 1, false, &[1, 2, 3]), Ok(Answer::Ack));
    assert_eq!(read(&mut otg, GINTSTS) & RXFLVL, 0);
    assert_eq!(otg.out(0, 1, true, &[4]), Ok(Answer::Ack));
    // DATA1 in bits 15 and 16.
    assert_eq!(read(&mut otg, GRXSTSP), OUT_DATA << 17 | 0b10 << 15 | 1 << 4 | 1);
}

#[test]
fn receive_fifo_overflows_by_name() {
    let mut otg = device();
    write(&mut otg, GRXFSIZ, 17);
    write(&mut otg, doepctl(1) + TSIZ, (3 * ONE) | 192);
    let ctl = read(&mut otg, doepctl(1));
    write(&mut otg, doepctl(1), ctl & !NAKSTS | EPENA | CNAK);
    // A packet of 64 bytes takes 16 words and two of status.
    let over = otg.out(0, 1, false, &[0; 64]).unwrap_err();
    assert!(over.contains("18 words exceed the receive FIFO of 17"), "{over}");
}

#[test]
fn stall_and_nak_are_set_and_cleared_apart() {
    let mut otg = device();
    let ctl = read(&mut otg, diepctl(1));
    write(&mut otg, diepctl(1), ctl | STALL);
    assert_eq!(otg.take(0, 1), Ok(Answer::Stall));
    write(&mut otg, diepctl(1), ctl & !STALL);
    assert_eq!(otg.take(0, 1), Ok(Answer::Nak));
    send(&mut otg, 0);
    let ctl = read(&mut otg, diepctl(1));
    write(&mut otg, diepctl(1), ctl | SNAK);
    assert_eq!((otg.take(0, 1), read(&mut otg, diepctl(1)) & NAKSTS), (Ok(Answer::Nak), NAKSTS));
    // EPDIS ends the transfer.
    write(&mut otg, diepctl(1), ctl | EPDIS | SNAK);
    assert_eq!(read(&mut otg, diepctl(1)) & EPENA, 0);
    assert_eq!(read(&mut otg, diepctl(1) + INT) & EPDISD, EPDISD);
    // Endpoint 0's STALL cannot be cleared but by the next SETUP.
    write(&mut otg, doepctl(0), STALL);
    write(&mut otg, doepctl(0), 0);
    assert_eq!(otg.out(0, 0, false, &[]), Ok(Answer::Stall));
    assert_eq!(otg.setup(0, [0; 8]), Ok(Answer::Ack));
    assert_eq!(read(&mut otg, doepctl(0)) & STALL, 0);
}

#[test]
fn address_holds_from_the_status_stage_on() {
    let mut otg = device();
    write(&mut otg, DCFG, 0x0220_0003 | 9 << 4);
    // The status stage of SET_ADDRESS still has the former address.
    write(&mut otg, diepctl(0) + TSIZ, ONE);
    write(&mut otg, diepctl(0), EPENA | CNAK);
    assert_eq!(otg.take(9, 0), Ok(Answer::Silence));
    assert!(matches!(otg.take(0, 0), Ok(Answer::Data(_, data)) if data.is_empty()));
    assert_eq!(otg.setup(0, [0; 8]), Ok(Answer::Silence));
    assert_eq!(otg.setup(9, [0; 8]), Ok(Answer::Ack));
}

#[test]
fn bus_reset_switches_endpoints_off() {
    let mut otg = device();
    send(&mut otg, 0);
    otg.bus_reset();
    assert_eq!(otg.take(0, 1), Ok(Answer::Silence));
    assert_eq!(read(&mut otg, diepctl(1)) & (USBAEP | NAKSTS), NAKSTS);
    // Endpoint 0 is always active.
    assert_eq!(read(&mut otg, diepctl(0)) & (USBAEP | NAKSTS), USBAEP | NAKSTS);
}
