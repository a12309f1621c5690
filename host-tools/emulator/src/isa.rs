//! Decoder of Thumb-2 for timing on a Cortex-M4F.
//!
//! It finds an instruction's length, its row of the TRM's timing tables, the registers that tie it
//! to its neighbours, and whether it can branch. Encodings are from the ARMv7-M Architecture
//! Reference Manual (DDI 0403), chapters A5 to A7. [`Instruction::decode`] returns `None` for
//! unknown instructions and for those an M4F lacks (double precision, `VSEL` and similar). The
//! machine stops there.

/// Row of an instruction in the timing tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Arithmetic, logic, moves, multiplications of every kind and DSP: one cycle.
    Simple,
    /// Load of up to one word into a core register.
    Load,
    /// Store of up to one word from a core register.
    Store,
    /// Load or store of this many words.
    ///
    /// These are LDM, STM, PUSH, POP, LDRD, STRD, VLDM, VSTM, and VLDR and VSTR of two words.
    Words(u8),
    /// VLDR of one word.
    FloatLoad,
    /// VSTR of one word.
    FloatStore,
    /// SDIV, UDIV.
    Divide,
    /// Floating-point arithmetic except the two classes below; moves to and from core registers.
    Float,
    /// VMLA, VFMA and similar.
    FloatMultiplyAdd,
    /// VDIV, VSQRT.
    FloatDivide,
    /// Move of two registers between core and floating-point unit.
    MovePair,
    /// MRS, MSR, CPS.
    Special,
    /// TBB, TBH.
    TableBranch,
}

/// Address that control goes to after an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flow {
    /// Always the next instruction.
    Next,
    /// The next instruction or another one.
    Maybe,
    /// Always another instruction.
    Elsewhere,
}

/// Set of floating-point registers s0…s31 and the comparison flags, one bit each.
pub type FloatSet = u64;

/// Comparison flags, which VCMP sets and VMRS reads.
const FLAGS: FloatSet = 1 << 32;

/// Decoded instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Instruction {
    /// Length in bytes: 2 or 4.
    pub size: u8,
    /// Row of the timing tables.
    pub class: Class,
    /// Address that control goes to.
    pub flow: Flow,
    /// Whether an IT block can skip the instruction.
    pub conditional: bool,
    /// Floating-point registers that the instruction reads.
    pub float_uses: FloatSet,
    /// Floating-point registers among them that only the addition of a multiply-add reads.
    pub addend: FloatSet,
    /// Floating-point registers that receive an arithmetic result.
    pub float_result: FloatSet,
    /// Whether the floating-point unit takes part.
    pub float: bool,
    /// Core registers that a load writes, one bit each.
    pub loads: u16,
    /// Core registers that arithmetic writes, one bit each.
    pub results: u16,
    /// Core registers in the address of a load or store, one bit each.
    pub address: u16,
    /// Number of following instructions that an IT makes conditional.
    pub it_length: u8,
    /// Distance of the loaded constant from the program counter, rounded down to a word.
    pub literal: Option<i16>,
}

const PC: u16 = 15;

impl Instruction {
    const fn new(size: u8, class: Class) -> Self {
        Self {
            size,
            class,
            flow: Flow::Next,
            conditional: false,
            float_uses: 0,
            addend: 0,
            float_result: 0,
            float: false,
            loads: 0,
            results: 0,
            address: 0,
            it_length: 0,
            literal: None,
        }
    }

    const fn going(self, flow: Flow) -> Self {
        Self { flow, ..self }
    }

    const fn reading(self, literal: Option<i16>) -> Self {
        Self { literal, ..self }
    }

    /// Adds the result of arithmetic; comparisons name the program counter as theirs.
    const fn giving(self, register: u16) -> Self {
        let results = if register == PC { 0 } else { self.results | 1 << register };
        Self { results, ..self }
    }

    const fn going_if(self, elsewhere: bool) -> Self {
        if elsewhere { self.going(Flow::Elsewhere) } else { self }
    }

    /// Decodes the instruction at the start of `code`; `None` if an M4F has none that is modelled.
    pub fn decode(code: &[u8]) -> Option<Self> {
        let half = |at: usize| Some(u16::from_le_bytes([*code.get(at)?, *code.get(at + 1)?]));
        let first = half(0)?;
        if first >= 0xe800 { wide(first, half(2)?) } else { narrow(first) }
    }
}

const fn bit(word: u16, at: u16) -> bool {
    word >> at & 1 == 1
}

const fn field(word: u16, from: u16, bits: u16) -> u16 {
    word >> from & ((1 << bits) - 1)
}

/// Decodes a 16-bit encoding (DDI 0403, A5.2).
fn narrow(op: u16) -> Option<Instruction> {
    use Class::{Load, Simple, Special, Store, Words};
    use Flow::{Elsewhere, Maybe};
    let new = |class| Instruction::new(2, class);
    let access = |load: bool, rt: u16, address: u16| Instruction {
        loads: if load { 1 << rt } else { 0 },
        address,
        ..new(if load { Load } else { Store })
    };
    Some(match op >> 10 {
        0b000000..=0b000111 => new(Simple).giving(field(op, 0, 3)),
        // CMP among MOV, ADD and SUB of a constant.
        0b001000..=0b001111 if field(op, 11, 2) == 0b01 => new(Simple),
        0b001000..=0b001111 => new(Simple).giving(field(op, 8, 3)),
        // TST, CMP, CMN among arithmetic of registers.
        0b010000 if matches!(field(op, 6, 4), 0b1000 | 0b1010 | 0b1011) => new(Simple),
        0b010000 => new(Simple).giving(field(op, 0, 3)),
        // ADD, MOV to the program counter; BX, BLX.
        0b010001 => match field(op, 8, 2) {
            0b11 => new(Simple).going(Elsewhere),
            0b01 => new(Simple),
            _ => {
                let rd = field(op, 7, 1) << 3 | field(op, 0, 3);
                new(Simple).giving(rd).going_if(rd == PC)
            }
        },
        0b010010 | 0b010011 => {
            access(true, field(op, 8, 3), 0).reading(Some(4 * field(op, 0, 8) as i16))
        }
        0b010100..=0b010111 => {
            let load = field(op, 9, 3) >= 0b011;
            access(load, field(op, 0, 3), 1 << field(op, 3, 3) | 1 << field(op, 6, 3))
        }
        0b011000..=0b100011 => access(bit(op, 11), field(op, 0, 3), 1 << field(op, 3, 3)),
        0b100100..=0b100111 => access(bit(op, 11), field(op, 8, 3), 1 << 13),
        0b101000..=0b101011 => new(Simple).giving(field(op, 8, 3)),
        0b101100..=0b101111 => match field(op, 8, 4) {
            // ADD and SUB of the stack pointer; extensions and reversals.
            0b0000 => new(Simple).giving(13),
            0b0010 | 0b1010 => new(Simple).giving(field(op, 0, 3)),
            // CBZ, CBNZ.
            0b0001 | 0b0011 | 0b1001 | 0b1011 => new(Simple).going(Maybe),
            0b0100 | 0b0101 => new(Words(field(op, 0, 9).count_ones() as u8)),
            0b1100 | 0b1101 => new(Words(field(op, 0, 9).count_ones() as u8)).going_if(bit(op, 8)),
            0b0110 => new(Special),
            // BKPT stops the machine for the host.
            0b1110 => new(Simple),
            0b1111 if field(op, 0, 4) == 0 => new(Simple),
            0b1111 => {
                let length = 4 - field(op, 0, 4).trailing_zeros() as u8;
                Instruction { it_length: length, ..new(Simple) }
            }
            _ => return None,
        },
        0b110000..=0b110011 => new(Words(field(op, 0, 8).count_ones() as u8)),
        0b110100..=0b110111 => match field(op, 8, 4) {
            // UDF, SVC: an exception's time is not the instruction's.
            0b1110 | 0b1111 => new(Simple),
            _ => new(Simple).going(Maybe),
        },
        0b111000 | 0b111001 => new(Simple).going(Elsewhere),
        _ => return None,
    })
}

/// Decodes a 32-bit encoding (DDI 0403, A5.3).
fn wide(op: u16, arg: u16) -> Option<Instruction> {
    use Class::{Divide, Simple, Special};
    use Flow::{Elsewhere, Maybe};
    let new = |class| Instruction::new(4, class);
    Some(match (field(op, 11, 2), field(op, 8, 3), field(op, 4, 7)) {
        (0b01, 0b000 | 0b001, _) if !bit(op, 6) => {
            new(Class::Words(arg.count_ones() as u8)).going_if(bit(op, 4) && bit(arg, PC))
        }
        (0b01, 0b000 | 0b001, _) => dual(op, arg),
        (0b01, 0b010 | 0b011, _) => new(Simple).giving(field(arg, 8, 4)),
        (0b01, 0b100.., _) => {
            return float(op, arg).map(|instruction| Instruction { float: true, ..instruction });
        }
        (0b10, ..) if !bit(arg, 15) => new(Simple).giving(field(arg, 8, 4)),
        (0b10, _, hints) => match (field(arg, 14, 1), field(arg, 12, 1)) {
            (0, 0) if hints & 0b0111000 != 0b0111000 => new(Simple).going(Maybe),
            (0, 0) => match hints {
                // MSR, MRS, CPS; NOP and other hints share the encoding of CPS, barriers have their
                // own.
                0b0111000 | 0b0111001 | 0b0111010 | 0b0111110 | 0b0111111 => new(Special),
                0b0111011 => new(Simple),
                _ => return None,
            },
            (0, _) => new(Simple).going(Elsewhere),
            (_, 1) => new(Simple).going(Elsewhere),
            _ => return None,
        },
        (0b11, 0b000 | 0b001, _) => return single(op, arg),
        (0b11, 0b010, _) => new(Simple).giving(field(arg, 8, 4)),
        (0b11, 0b011, _) if !bit(op, 7) => new(Simple).giving(field(arg, 8, 4)),
        (0b11, 0b011, _) => match (field(op, 4, 3), field(arg, 4, 4)) {
            (0b001 | 0b011, 0b1111) => new(Divide).giving(field(arg, 8, 4)),
            _ => new(Simple).giving(field(arg, 8, 4)).giving(field(arg, 12, 4)),
        },
        _ => return None,
    })
}

/// Distance of a constant from the program counter, if `op` addresses by it.
const fn literal(op: u16, distance: u16) -> Option<i16> {
    if field(op, 0, 4) != PC {
        return None;
    }
    Some(if bit(op, 7) { distance as i16 } else { -(distance as i16) })
}

/// Decodes LDRD, STRD, exclusives and table branches.
fn dual(op: u16, arg: u16) -> Instruction {
    let new = |class| Instruction::new(4, class);
    let base = 1 << field(op, 0, 4);
    match (field(op, 7, 2), field(op, 4, 2)) {
        (0b00, 0b00) => Instruction { address: base, ..new(Class::Store) },
        (0b00, 0b01) => {
            Instruction { loads: 1 << field(arg, 12, 4), address: base, ..new(Class::Load) }
        }
        (0b01, 0b00) => Instruction { address: base, ..new(Class::Store) },
        (0b01, 0b01) if field(arg, 5, 3) == 0 => new(Class::TableBranch).going(Flow::Elsewhere),
        (0b01, 0b01) => {
            Instruction { loads: 1 << field(arg, 12, 4), address: base, ..new(Class::Load) }
        }
        _ => new(Class::Words(2)).reading(literal(op, 4 * field(arg, 0, 8))),
    }
}

/// Decodes loads and stores of one core register.
fn single(op: u16, arg: u16) -> Option<Instruction> {
    let (rn, rt) = (field(op, 0, 4), field(arg, 12, 4));
    let load = bit(op, 4);
    let by_register = !bit(op, 7) && field(arg, 6, 6) == 0 && rn != PC;
    let base = if rn == PC { 0 } else { 1 << rn };
    let address = if by_register { base | 1 << field(arg, 0, 4) } else { base };
    let new = |class| Instruction { address, ..Instruction::new(4, class) };
    Some(match (load, field(op, 5, 2)) {
        (_, 0b11) => return None,
        (false, _) => new(Class::Store),
        (true, 0b10) => Instruction { loads: 1 << rt, ..new(Class::Load) }.going_if(rt == PC),
        // A byte or halfword into the program counter is a preload hint.
        (true, _) if rt == PC => Instruction::new(4, Class::Simple),
        (true, _) => Instruction { loads: 1 << rt, ..new(Class::Load) },
    })
    .map(|instruction| instruction.reading(literal(op, field(arg, 0, 12))))
}

/// Set with one single-precision register; its number is four bits and one more.
const fn single_register(four: u16, one: bool) -> FloatSet {
    1 << (four << 1 | one as u16)
}

/// Decodes floating-point encodings (DDI 0403, A6.4).
fn float(op: u16, arg: u16) -> Option<Instruction> {
    let new = |class| Instruction::new(4, class);
    // Coprocessors 10 and 11; the unconditional encodings belong to a later architecture.
    if field(arg, 9, 3) != 0b101 || bit(op, 12) {
        return None;
    }
    let double = bit(arg, 8);
    let (n, d, m) = (field(op, 0, 4), field(arg, 12, 4), field(arg, 0, 4));
    let (sn, sm) = (single_register(n, bit(arg, 7)), single_register(m, bit(arg, 5)));
    let sd = single_register(d, bit(op, 6));
    if field(op, 9, 1) == 0 {
        if field(op, 5, 7) == 0b1100010 {
            let both = if double { 0b11 << (2 * m) } else { sm | sm << 1 };
            let float_uses = if bit(op, 4) { both } else { 0 };
            return Some(Instruction { float_uses, ..new(Class::MovePair) });
        }
        let one = bit(op, 8) && !bit(op, 5);
        let words = if one { 1 + u16::from(double) } else { field(arg, 0, 8) };
        let first = if double { 2 * d } else { d << 1 | u16::from(bit(op, 6)) };
        let all = (1u64.checked_shl(u32::from(words))? - 1) << first;
        let float_uses = if bit(op, 4) { 0 } else { all & (FLAGS - 1) };
        let class = match (one && !double, bit(op, 4)) {
            (true, true) => Class::FloatLoad,
            (true, false) => Class::FloatStore,
            _ => Class::Words(u8::try_from(words).ok()?),
        };
        let address = if n == PC { 0 } else { 1 << n };
        let literal = literal(op, 4 * field(arg, 0, 8)).filter(|_| one);
        return Some(Instruction { float_uses, address, ..new(class) }.reading(literal));
    }
    if bit(arg, 4) {
        return Some(match (bit(arg, 8), field(op, 5, 3)) {
            (false, 0b000) if bit(op, 4) => Instruction { float_uses: sn, ..new(Class::Float) },
            (false, 0b111) if bit(op, 4) => Instruction { float_uses: FLAGS, ..new(Class::Float) },
            (false, 0b000 | 0b111) => new(Class::Float),
            // A word of a double register: both halves count as used.
            (true, 0b000 | 0b001) => {
                let float_uses = if bit(op, 4) { 0b11 << (2 * n) } else { 0 };
                Instruction { float_uses, ..new(Class::Float) }
            }
            _ => return None,
        });
    }
    if double {
        return None;
    }
    let arithmetic =
        |class, float_uses| Some(Instruction { float_uses, float_result: sd, ..new(class) });
    match (bit(op, 7), field(op, 4, 2), bit(arg, 6)) {
        (false, 0b00 | 0b01, _) | (true, 0b01 | 0b10, _) => {
            let addend = sd & !(sn | sm);
            arithmetic(Class::FloatMultiplyAdd, sd | sn | sm)
                .map(|instruction| Instruction { addend, ..instruction })
        }
        (false, _, _) => arithmetic(Class::Float, sn | sm),
        (true, 0b00, false) => arithmetic(Class::FloatDivide, sn | sm),
        (true, 0b00, true) => None,
        // VMOV of a constant or a register computes nothing.
        (true, _, false) => Some(new(Class::Float)),
        (true, _, true) => match (n, bit(arg, 7)) {
            (0b0000, false) => Some(Instruction { float_uses: sm, ..new(Class::Float) }),
            (0b0001, true) => arithmetic(Class::FloatDivide, sm),
            (0b0000, true) | (0b0001, false) | (0b0010 | 0b0011 | 0b1000 | 0b1100 | 0b1101, _) => {
                arithmetic(Class::Float, sm)
            }
            // Fixed point: the register is its own operand.
            (0b1010 | 0b1011 | 0b1110 | 0b1111, _) => arithmetic(Class::Float, sd),
            (0b0100, _) => {
                Some(Instruction { float_result: FLAGS, ..new(Class::Float) }.using(sd | sm))
            }
            (0b0101, _) => Some(Instruction { float_result: FLAGS, ..new(Class::Float) }.using(sd)),
            _ => None,
        },
    }
}

impl Instruction {
    const fn using(self, float_uses: FloatSet) -> Self {
        Self { float_uses, ..self }
    }
}

#[cfg(test)]
mod tests;
