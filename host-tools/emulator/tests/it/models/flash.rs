//! Flash: keys, erasure, programming, errors, the time of an operation, the data cache.

use taxel_emulator::board::model::Model::{self, F411, G431};
use taxel_emulator::board::time::{Tick, micros};

use super::Driver;

const KEYS: [u32; 2] = [0x4567_0123, 0xcdef_89ab];
const BSY: u32 = 1 << 16;
const STRT: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;
const DCEN: u32 = 1 << 10;
const DCRST: u32 = 1 << 12;
const PG: u32 = 1;

/// Registers and operations of a chip's flash.
struct Flash {
    model: Model,
    acr: u32,
    keyr: u32,
    sr: u32,
    cr: u32,
    /// Start of a page or sector, and the CR that erases it without STRT.
    page: (u32, u32),
    /// CR that programs.
    program: u32,
    /// Times to erase it and to program the smallest unit (typical).
    erasing: Tick,
    programming: Tick,
}

/// RM0440 §3.7: page 58 of 2 KB, double words.
const G4: Flash = Flash {
    model: G431,
    acr: 0x4002_2000,
    keyr: 0x4002_2008,
    sr: 0x4002_2010,
    cr: 0x4002_2014,
    page: (0x0801_d000, 1 << 1 | 58 << 3),
    program: PG,
    erasing: micros(22_020),
    programming: micros(82),
};

/// RM0383 §3.8: sector 1 of 16 KB, words by PSIZE = x32.
const F4: Flash = Flash {
    model: F411,
    acr: 0x4002_3c00,
    keyr: 0x4002_3c04,
    sr: 0x4002_3c0c,
    cr: 0x4002_3c10,
    page: (0x0800_4000, 1 << 1 | 1 << 3 | 2 << 8),
    program: PG | 2 << 8,
    erasing: micros(250_000),
    programming: micros(16),
};

impl Flash {
    fn driver(&self) -> Driver {
        Driver::new(self.model)
    }

    fn unlock(&self, driver: &mut Driver) {
        KEYS.iter().for_each(|key| driver.write(self.keyr, *key));
        assert_eq!(driver.read(self.cr) & LOCK, 0);
    }

    fn erase(&self, driver: &mut Driver) {
        driver.write(self.cr, self.page.1);
        driver.write(self.cr, self.page.1 | STRT);
        driver.wait(self.erasing);
        driver.write(self.cr, 0);
    }

    /// Programs a word at an offset of the page, without waiting.
    fn put(&self, driver: &mut Driver, offset: u32, value: u32) -> Result<(), String> {
        let now = driver.now;
        driver.chip.flash().program(self.page.0 + offset, 4, value, now)
    }

    /// Programs a double word and waits.
    fn put_two(&self, driver: &mut Driver, offset: u32, values: [u32; 2]) {
        for (offset, value) in [offset, offset + 4].into_iter().zip(values) {
            self.put(driver, offset, value).unwrap();
            let busy = driver.chip.flash().busy_until().saturating_sub(driver.now);
            driver.wait(busy);
        }
    }

    fn get(&self, driver: &mut Driver, offset: u32) -> Result<u32, String> {
        driver.chip.flash().fetch(self.page.0 + offset, 4).map(|(value, _)| value)
    }
}

#[test]
fn wrong_key_locks_until_the_next_reset() {
    for flash in [G4, F4] {
        let mut driver = flash.driver();
        let locked = driver.refused(flash.cr, flash.program);
        assert!(locked.contains("written while CR is locked"), "{locked}");
        // The keys in the wrong order: not even the right order helps.
        for key in [KEYS[1], KEYS[0], KEYS[1]] {
            let wrong = driver.refused(flash.keyr, key);
            assert!(wrong.contains("locks the flash until the next reset"), "{wrong}");
        }
        assert_eq!(driver.read(flash.cr) & LOCK, LOCK);
        driver.reset();
        flash.unlock(&mut driver);
        driver.write(flash.cr, LOCK);
        assert_eq!(driver.read(flash.cr), LOCK);
    }
}

#[test]
fn busy_flag_lasts_for_the_operation() {
    for flash in [G4, F4] {
        let mut driver = flash.driver();
        flash.unlock(&mut driver);
        assert_eq!(driver.read(flash.sr), 0);
        driver.write(flash.cr, flash.page.1);
        driver.write(flash.cr, flash.page.1 | STRT);
        assert_eq!(driver.read(flash.sr), BSY);
        // No register may be written meanwhile, and no cell.
        let busy = driver.refused(flash.cr, flash.program);
        assert!(busy.contains("written while the flash is busy (SR.BSY)"), "{busy}");
        driver.wait(flash.erasing - 1);
        assert_eq!(driver.read(flash.sr), BSY);
        let busy = flash.put(&mut driver, 0, 1).unwrap_err();
        assert!(busy.contains("while it is busy"), "{busy}");
        driver.wait(1);
        assert_eq!(driver.read(flash.sr), 0);

        driver.write(flash.cr, flash.program);
        flash.put(&mut driver, 0, 0x1234_5678).unwrap();
        if flash.model == G431 {
            // The first half of a double word waits for the second.
            assert_eq!(driver.read(flash.sr), 0);
            flash.put(&mut driver, 4, 0x9abc_def0).unwrap();
        }
        assert_eq!(driver.read(flash.sr), BSY);
        driver.wait(flash.programming);
        assert_eq!(driver.read(flash.sr), 0);
        driver.write(flash.cr, LOCK);
    }
}

#[test]
fn erasure_fills_one_page_with_ones() {
    for flash in [G4, F4] {
        let mut driver = flash.driver();
        flash.unlock(&mut driver);
        driver.write(flash.cr, flash.program);
        let behind = if flash.model == G431 { 0x800 } else { 0x4000 };
        for offset in [0, behind - 8, behind] {
            flash.put_two(&mut driver, offset, [0x0102_0304, 0x0506_0708]);
        }
        driver.write(flash.acr, 0);
        assert_eq!(flash.get(&mut driver, behind - 4), Ok(0x0506_0708));
        flash.erase(&mut driver);
        for (offset, word) in [(0, !0), (behind - 4, !0), (behind, 0x0102_0304)] {
            assert_eq!(flash.get(&mut driver, offset), Ok(word));
        }
        // STRT without a kind of erasure.
        let which = driver.refused(flash.cr, STRT);
        assert!(which.contains("STRT without"), "{which}");
    }
}

#[test]
fn data_cache_is_stale_until_its_reset() {
    for flash in [G4, F4] {
        let mut driver = flash.driver();
        flash.unlock(&mut driver);
        driver.write(flash.acr, DCEN);
        assert_eq!(flash.get(&mut driver, 0), Ok(!0));
        flash.erase(&mut driver);
        let stale = flash.get(&mut driver, 0).unwrap_err();
        assert!(stale.contains("the data cache was not reset"), "{stale}");
        let on = driver.refused(flash.acr, DCEN | DCRST);
        assert!(on.contains("a cache is reset while it is on"), "{on}");
        for acr in [0, DCRST, 0, DCEN] {
            driver.write(flash.acr, acr);
        }
        assert_eq!(flash.get(&mut driver, 0), Ok(!0));
    }
}

#[test]
fn g431_program_without_erasure_sets_progerr() {
    const PROGERR: u32 = 1 << 3;
    const PGSERR: u32 = 1 << 7;
    let mut driver = G4.driver();
    G4.unlock(&mut driver);
    driver.write(G4.acr, 0);
    driver.write(G4.cr, G4.program);
    G4.put_two(&mut driver, 0, [1, 2]);
    assert_eq!(driver.read(G4.sr), 0);
    // The double word stays, and the error stands until it is cleared by a one.
    G4.put_two(&mut driver, 0, [0, 2]);
    assert_eq!(driver.read(G4.sr), PROGERR);
    assert_eq!([G4.get(&mut driver, 0), G4.get(&mut driver, 4)], [Ok(1), Ok(2)]);
    // With the error standing nothing is programmed or erased (RM0440 §3.7.5: PGSERR).
    G4.put_two(&mut driver, 8, [3, 4]);
    assert_eq!(driver.read(G4.sr), PROGERR | PGSERR);
    assert_eq!(G4.get(&mut driver, 8), Ok(!0));
    driver.write(G4.cr, 0);
    driver.write(G4.cr, G4.page.1 | STRT);
    assert_eq!((driver.read(G4.sr), G4.get(&mut driver, 0)), (PROGERR | PGSERR, Ok(1)));
    driver.write(G4.sr, PROGERR | PGSERR);
    driver.write(G4.cr, G4.program);
    G4.put_two(&mut driver, 8, [3, 4]);
    assert_eq!((driver.read(G4.sr), G4.get(&mut driver, 12)), (0, Ok(4)));
    // All zeros are the one double word that may be programmed over another.
    G4.put_two(&mut driver, 0, [0, 0]);
    assert_eq!((driver.read(G4.sr), G4.get(&mut driver, 4)), (0, Ok(0)));
}

#[test]
fn g431_programs_double_words_only() {
    let refused = |offsets: [u32; 2]| {
        let mut driver = G4.driver();
        G4.unlock(&mut driver);
        driver.write(G4.cr, G4.program);
        let first = G4.put(&mut driver, offsets[0], 1);
        first.and_then(|()| G4.put(&mut driver, offsets[1], 2)).unwrap_err()
    };
    assert!(refused([4, 8]).contains("is not its lower one"));
    assert!(refused([0, 8]).contains("does not follow the first"));
    // Without PG.
    let mut driver = G4.driver();
    G4.unlock(&mut driver);
    assert!(G4.put(&mut driver, 0, 1).unwrap_err().contains("without PG"));
    // The program's own pages.
    let program = driver.refused(G4.cr, 1 << 1 | 3 << 3 | STRT);
    assert!(program.contains("holds the program"), "{program}");
}

#[test]
fn f411_programming_clears_bits_only() {
    let mut driver = F4.driver();
    F4.unlock(&mut driver);
    driver.write(F4.acr, 0);
    driver.write(F4.cr, F4.program);
    for (value, read) in [(0xffff_00ff, 0xffff_00ff), (0x1234_ffff, 0x1234_00ff)] {
        F4.put(&mut driver, 0, value).unwrap();
        driver.wait(F4.programming);
        assert_eq!(F4.get(&mut driver, 0), Ok(read));
    }
    // PSIZE = x8 does not fit a word.
    driver.write(F4.cr, PG);
    assert!(F4.put(&mut driver, 4, 0).unwrap_err().contains("PSIZE = x32"));
    driver.write(F4.cr, 0);
    assert!(F4.put(&mut driver, 4, 0).unwrap_err().contains("without PG"));
}

#[test]
fn f411_erases_faster_with_more_bits_at_once() {
    // PSIZE = x8, x16, x32: DS10314 table 47, a sector of 16 KB.
    for (psize, us) in [(0, 400_000), (1, 300_000), (2, 250_000)] {
        let mut driver = F4.driver();
        F4.unlock(&mut driver);
        driver.write(F4.cr, 1 << 1 | 1 << 3 | psize << 8);
        driver.write(F4.cr, 1 << 1 | 1 << 3 | psize << 8 | STRT);
        driver.wait(micros(us) - 1);
        assert_eq!(driver.read(F4.sr), BSY);
        driver.wait(1);
        assert_eq!(driver.read(F4.sr), 0);
    }
}
