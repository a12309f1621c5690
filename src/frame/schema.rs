//! Schema of a frame's fields and status bits, from which all other lists are generated.
//!
//! Macros make [`Frame`](super::Frame), its encoder and reader, [`Fields`] and [`Status`] from it.
//! `cargo xtask protocol` generates from [`FIELDS`], [`CSV`] and [`BITS`] the columns of
//! recordings, `docs/protocol.md`, `docs/read-the-numbers.md`, the Python package, the C header and
//! the page.
//!
//! To add a field, append it to `tail` and to [`CSV`]. To add a bit, append it. Never renumber.

use serde::{Deserialize, Serialize};

use crate::scan::SENSORS;

/// Hands every field to the macro `$with`, in the wire's order.
///
/// Every frame carries a presence byte for each field of `head`. A frame ends after the last field
/// of `tail` that is present. A host that does not know a field can therefore read every frame that
/// it did not ask to carry it.
#[macro_export]
macro_rules! frame_fields {
    ($with:ident) => {
        $with! {
            head {
                codes: $crate::scan::Codes = CODES(0) "ADC codes" {
                    layout: Type::Named("Codes"),
                    columns: &[Columns::Whole("lit_r0c0 lit_r0c1 lit_r0c2 lit_r0c3 lit_r1c0 lit_r1c1 lit_r1c2 lit_r1c3 \
                              lit_r2c0 lit_r2c1 lit_r2c2 lit_r2c3 lit_r3c0 lit_r3c1 lit_r3c2 lit_r3c3 \
                              dark_c0 dark_c1 dark_c2 dark_c3 \
                              bridge_s0_a bridge_s0_b bridge_s0_c bridge_s0_d \
                              bridge_s1_a bridge_s1_b bridge_s1_c bridge_s1_d \
                              bridge_s2_a bridge_s2_b bridge_s2_c bridge_s2_d \
                              bridge_s3_a bridge_s3_b bridge_s3_c bridge_s3_d \
                              aux_vref aux_temp")],
                    rows: &[Row("`lit_r0c0` … `bridge_s3_d`, `aux_…`", "codes", "readings of the converter")],
                }
                signals: $crate::condition::Signals = SIGNALS(1) "Conditioned signals and channel health" {
                    layout: Type::Named("Signals"),
                    columns: &[Columns::Real("c_r0c0 c_r0c1 c_r0c2 c_r0c3 c_r1c0 c_r1c1 c_r1c2 c_r1c3 \
                              c_r2c0 c_r2c1 c_r2c2 c_r2c3 c_r3c0 c_r3c1 c_r3c2 c_r3c3 \
                              s0_ux s0_uy s0_uz s1_ux s1_uy s1_uz s2_ux s2_uy s2_uz s3_ux s3_uy s3_uz"),
                              Columns::Whole("saturated dead bridge_faults")],
                    rows: &[
                        Row("`c_r0c0` … `c_r3c3`", "of full scale",
                            "a taxel's change against the unloaded finger: **negative where the facet came nearer**"),
                        Row("`s0_ux` … `s3_uz`", "of full scale", "a bridge's outputs less their bias"),
                        Row("`saturated` `dead` `bridge_faults`", "bits",
                            "clipped taxels, dead taxels, faulty bridges"),
                    ],
                }
                sensors: [$crate::estimate::Force; $crate::scan::SENSORS] = SENSORS(2) "Force on each MEMS sensor" {
                    layout: Type::Array(&FORCE, SENSORS),
                    columns: &[Columns::Measured("s0_fx_n s0_fy_n s0_fz_n s1_fx_n s1_fy_n s1_fz_n \
                              s2_fx_n s2_fy_n s2_fz_n s3_fx_n s3_fy_n s3_fz_n")],
                    rows: &[Row("`s0_fx_n` … `s3_fz_n`", "N", "force on each MEMS sensor")],
                }
                force: $crate::estimate::Force = FORCE(3) "Force on the finger: zero, not missing, without contact" {
                    layout: FORCE,
                    columns: &[Columns::Measured("fx_n fy_n fz_n")],
                    rows: &[Row("`fx_n` `fy_n` `fz_n`", "N",
                        "force on the finger; x along a row, y along the columns, **z positive into the skin**. Zero, not \
                         missing, without contact")],
                }
                point: $crate::measured::Measured<$crate::estimate::ContactPoint> = POINT(4) "Contact point" {
                    layout: Type::Result(&POINT),
                    columns: &[Columns::Measured("x_mm y_mm")],
                    rows: &[Row("`x_mm` `y_mm`", "mm", "contact point, from the middle of the matrix")],
                }
                slip: $crate::measured::Measured<$crate::estimate::slip::Verdict> = SLIP(5) "Slip margin, friction, and the grip that it takes" {
                    layout: Type::Result(&Type::Struct(
                        "Slip",
                        "``margin`` is what is left of the friction, 1 unloaded and 0 at the limit; ``grip_n`` the normal \
                         force that would leave a third of it.",
                        &[
                            Member("margin", "margin", Type::F32),
                            Member("friction", "friction", Type::F32),
                            Member("grip_n", "grip_n", Type::F32),
                        ],
                    )),
                    columns: &[Columns::Measured("slip_margin friction grip_n")],
                    rows: &[
                        Row("`slip` `slip_margin`", "0, 1; –",
                            "gross slip; share of the friction limit that is left: 1 unloaded, 0 at the limit"),
                        Row("`friction` `grip_n`", "–; N",
                            "friction coefficient as last estimated; normal force that would leave a third of the limit. Two \
                             contacts are judged together, because force sensors under one plate cannot tell how they share \
                             the shear"),
                    ],
                }
                torsion: $crate::measured::Measured<$crate::units::NewtonMillimetres> = TORSION(6) "Moment about the contact's normal" {
                    layout: Type::Result(&Type::F32),
                    columns: &[Columns::Measured("torsion_nmm")],
                    rows: &[Row("`torsion_nmm`", "N·mm", "moment about the normal of the contact")],
                }
                contacts: $crate::measured::Measured<[$crate::estimate::NormalContact; 2]> = CONTACTS(7)
                    "Two contacts, the stronger first, if a single one does not explain the signals"
                {
                    layout: Type::Result(&Type::Array(&CONTACT, 2)),
                    columns: &[Columns::Measured("contact1_x_mm contact1_y_mm contact1_fz_n contact2_x_mm contact2_y_mm contact2_fz_n")],
                    rows: &[Row("`contact1_x_mm` … `contact2_fz_n`", "mm, N",
                        "two contacts, the stronger first, if a single one does not explain the signals")],
                }
            }
            tail {
                uncertainty: $crate::measured::Measured<$crate::estimate::Uncertainty> = UNCERTAINTY(8)
                    "Standard deviations of force and contact position, and the model's residual"
                {
                    layout: Type::Result(&Type::Struct(
                        "Uncertainty",
                        "Standard deviations of force and point, in newtons and millimetres; ``misfit`` is the residual of \
                         the skin model, 1 as in calibration.",
                        &[
                            Member("force", "force_sigma", FORCE),
                            Member("point", "point_sigma", Type::Result(&POINT)),
                            Member("misfit", "misfit", Type::Result(&Type::F32)),
                        ],
                    )),
                    columns: &[Columns::Measured("fx_sigma_n fy_sigma_n fz_sigma_n x_sigma_mm y_sigma_mm misfit")],
                    rows: &[
                        Row("`fx_sigma_n` … `fz_sigma_n` `x_sigma_mm` `y_sigma_mm`", "N, mm",
                            "standard deviations of force and contact point (field `uncertainty`, on request); those of the force are wider while its rate changes quickly"),
                        Row("`misfit`", "–",
                            "residual of the model of the skin over its residual in calibration: about 1 for a contact like \
                             those of the calibration, above 10 it is not a single contact"),
                    ],
                }
            }
        }
    };
}

/// Hands every bit of the status to the macro `$with`.
///
/// A bit of `flags` has its number, name, kind, title on the page, meaning and remedy. A bit of
/// `estimators` has its number, name, whether this build has the estimator, and its meaning.
macro_rules! status_bits {
    ($with:ident) => {
        $with! {
            flags {
                CONTACT 0 "contact" Good "Something touches the finger"
                    "the contact gate is open" ""
                UNCALIBRATED 1 "uncalibrated" Warning "Uncalibrated"
                    "this finger has no calibration of a force"
                    "upload a calibration: `taxel calibrate upload --calibration finger.toml`"
                SATURATED 2 "saturated" Fault "A taxel is clipped: the matrix gives no force"
                    "a taxel is clipped: the matrix gives no force, only the force sensors do"
                    "sun or a lamp on the skin, or too much pressure: shade it, press less"
                DEAD_TAXEL 3 "dead-taxel" Fault "A taxel sees no light, is stuck, jumps or is noisy alone: the matrix gives no force"
                    "a taxel sees no light from its LED, is stuck, or jumps or is noisy while the others are not: the matrix gives no force, only the force sensors do; the contact point leaves the taxel out"
                    "`taxel self-test`; check its LED, phototransistor and row driver"
                BRIDGE_FAULT 4 "bridge-fault" Fault "A force sensor's bridge is broken, is stuck, jumps or is noisy alone: it gives no force"
                    "a bridge midpoint is near a rail or stuck, or the mean of the four is not half the supply, or that mean jumps, or a code is noisy, while the others are not: that sensor gives no force"
                    "an open or shorted arm: check that sensor's wires"
                OUT_OF_RANGE 5 "out-of-range" Warning "Outside the calibrated range"
                    "a signal lies outside the calibrated range: values that need it are missing"
                    "press less, or calibrate with larger forces"
                OVERRUN 6 "overrun" Warning "Scans were lost"
                    "scans were lost just before this one"
                    "expected while the flash is written (an upload); else set a lower rate"
                BIASED 7 "biased" Good "A bias taken on command is active"
                    "a bias taken on command is active"
                    "`taxel bias clear` returns to the calibration's"
                STUCK_CHANNEL 8 "stuck-channel" Fault "A channel no longer changes: it is left out"
                    "a code no longer changes while the others do; `dead` or `bridge_faults` names it"
                    "check its wiring, as for a dead taxel or bridge"
                NOT_SINGLE 9 "not-single" Warning "Not a single contact"
                    "no single contact explains the signals; `contacts` may have two"
                    "an edge or two objects: trust the normal force, not the one point"
                DISAGREE 10 "disagree" Warning "Matrix and force sensors disagree"
                    "matrix and force sensors contradict each other; only the more certain one is given"
                    "`taxel bias take`; if it stays, calibrate again"
                SLIP_WARNING 11 "slip-warning" Warning "About to slip"
                    "the contact is about to slip; ends at a margin 0.02 above the one that it begins below"
                    "grip harder, with at least `grip_n`"
                SLIDES 12 "slides" Fault "It slides"
                    "gross slip: the whole contact moves"
                    "grip harder, or let go"
                TEMPERATURE 13 "temperature" Warning "Warmer or colder than was calibrated"
                    "the chip's thermometer is outside the calibrated temperatures"
                    "record the finger at rest while it warms (scene `warm-up`) and add that to `calibrate fit`"
                NOISY 14 "noisy" Warning "A force sensor is noisy"
                    "a force sensor is about 1.5 times or more as noisy as when its bias was taken"
                    "check supply and wires; a motor nearby"
                ROW_HELD 15 "row-held" Warning "A row is held on: no estimates"
                    "one LED row is on in every step, for a test: all codes are read under it, and nothing is estimated"
                    "it ends with the program that asked for it (`taxel record --hold-row 0 --out row.csv`)"
            }
            estimators {
                RAN_ARG_MIN 16 "ran-arg-min" true, "the arg-min contact point ran"
                RAN_CENTROID 17 "ran-centroid" true, "the centroid contact point ran"
                RAN_NET 18 "ran-net" true, "the force net ran"
                RAN_SENSORS 19 "ran-sensors" true, "the force of at least one sensor was computed"
                RAN_MODEL 20 "ran-model" cfg!(feature = "model"), "the skin model ran, at least for the normal force"
                RAN_SHEAR 21 "ran-shear" cfg!(feature = "model"), "the skin model ran with shear"
                RAN_PAIR 22 "ran-pair" cfg!(feature = "model"), "two contacts were looked for"
                RAN_ARRAY 23 "ran-array" cfg!(feature = "array"), "the force sensors' common wrench and contact ran"
                RAN_SLIP 24 "ran-slip" cfg!(feature = "slip"), "slip was judged"
                RAN_QUANTISED 25 "ran-quantised-net" cfg!(feature = "quantised"), "the force net in 16 bits ran"
                RAN_WARMTH 26 "ran-warmth" cfg!(feature = "warmth"), "the effect of temperature was taken off"
                RAN_LAG 27 "ran-lag" cfg!(feature = "lag"), "the lag of skin and force sensors was compensated"
                RAN_DRIFT 28 "ran-drift" cfg!(feature = "drift"), "drift is compensated: of the light, and at rest of every channel"
            }
        }
    };
}

/// First columns of every row of frames CSV.
pub const HEAD: [Row; 3] = [
    Row("t_us", "µs", "device time of the scan; 64 bits, from power-up"),
    Row("seq", "", "counts frames due: a gap is a loss"),
    Row("status", "bits", "the flags below"),
];

/// Groups of columns of frames CSV in their order, after those of [`HEAD`].
pub const CSV: [Group; 11] = [
    Group::Field(Fields::FORCE),
    Group::Field(Fields::POINT),
    Group::Field(Fields::TORSION),
    Group::Flag { column: "contact", bit: Status::CONTACT, with: Fields::empty() },
    Group::Flag { column: "slip", bit: Status::SLIDES, with: Fields::SLIP },
    Group::Field(Fields::SLIP),
    Group::Field(Fields::CONTACTS),
    Group::Field(Fields::UNCERTAINTY),
    Group::Field(Fields::SENSORS),
    Group::Field(Fields::SIGNALS),
    Group::Field(Fields::CODES),
];

/// Force on the finger or on one sensor.
const FORCE: Type = Type::Struct(
    "Force",
    "In newtons; z is the normal force.",
    &[
        Member("x", "x", Type::Result(&Type::F32)),
        Member("y", "y", Type::Result(&Type::F32)),
        Member("z", "z", Type::Result(&Type::F32)),
    ],
);

/// Contact position.
const POINT: Type = Type::Struct(
    "Point",
    "Contact position, in millimetres from the middle of the pad.",
    &[Member("x_mm", "x_mm", Type::F32), Member("y_mm", "y_mm", Type::F32)],
);

/// One of two contacts.
const CONTACT: Type = Type::Struct(
    "Contact",
    "One of two contacts.",
    &[Member("point", "point", POINT), Member("normal_n", "normal_n", Type::F32)],
);

/// Description of a field.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Name on the command line and in the clients.
    pub name: &'static str,
    /// Bit of the mask.
    pub mask: Fields,
    /// Whether the field belongs to the tail: a frame may end before it.
    pub tail: bool,
    /// Meaning in one line.
    pub meaning: &'static str,
    /// Layout on the wire.
    pub layout: Type,
    /// Columns of frames CSV.
    pub columns: &'static [Columns],
    /// Rows of the manual's table.
    pub rows: &'static [Row],
}

/// Columns of frames CSV with the same kind of cells; names are separated by spaces.
#[derive(Clone, Copy, Debug)]
pub enum Columns {
    /// Whole numbers.
    Whole(&'static str),
    /// Real numbers.
    Real(&'static str),
    /// Real numbers, or the reason why there is none.
    Measured(&'static str),
}

/// Layout of a value on the wire.
#[derive(Clone, Copy, Debug)]
pub enum Type {
    /// A structure of optional channels, for which every client has hand-written code.
    Named(&'static str),
    /// One `f32`, four bytes in little-endian order.
    F32,
    /// A value or the reason for its absence.
    Result(&'static Self),
    /// An array: type of an element and number of elements.
    Array(&'static Self, usize),
    /// Name, meaning and members.
    Struct(&'static str, &'static str, &'static [Member]),
}

/// Member of a structure: its name, its name in C, and its type.
#[derive(Clone, Copy, Debug)]
pub struct Member(pub &'static str, pub &'static str, pub Type);

/// Row of the manual's table of columns: the columns, their unit and their meaning.
#[derive(Clone, Copy, Debug)]
pub struct Row(pub &'static str, pub &'static str, pub &'static str);

/// Group of columns of frames CSV.
#[derive(Clone, Copy, Debug)]
pub enum Group {
    /// The columns of a field.
    Field(Fields),
    /// A bit of the status; present if the fields `with` are asked for.
    Flag {
        /// Name of the column.
        column: &'static str,
        /// Bit of the status.
        bit: Status,
        /// Fields that the column depends on; empty if it is always present.
        with: Fields,
    },
}

/// Description of a bit of the status.
#[derive(Clone, Copy, Debug)]
pub struct Bit {
    /// The bit as a mask.
    pub status: Status,
    /// Name in the tools' output.
    pub name: &'static str,
    /// Name of the constant.
    pub constant: &'static str,
    /// Severity.
    pub kind: Kind,
    /// Title on the page; empty for an estimator.
    pub title: &'static str,
    /// Meaning in one line.
    pub meaning: &'static str,
    /// Remedy for the user; empty if there is none.
    pub remedy: &'static str,
}

/// Severity of a status bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Normal state.
    Good,
    /// Values are missing or less certain.
    Warning,
    /// Something is broken, or the contact slides.
    Fault,
    /// An estimator ran.
    Estimator,
}

macro_rules! fields {
    ($($place:ident {
        $($name:ident: $type:ty = $NAME:ident($bit:literal) $meaning:literal { $($about:tt)* })*
    })*) => {
        /// Selection of fields, a bit each: the fields that a frame carries.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[serde(transparent)]
        pub struct Fields(pub u16);

        bitflags::bitflags! {
            impl Fields: u16 {
                $($(
                    #[doc = concat!("Bit ", $bit, ": ", $meaning, ".")]
                    const $NAME = 1 << $bit;
                )*)*
            }
        }

        /// Every field, in the wire's order.
        pub const FIELDS: &[Field] = &[$($(Field {
            name: stringify!($name),
            mask: Fields::$NAME,
            tail: matches!(stringify!($place).as_bytes(), b"tail"),
            meaning: $meaning,
            $($about)*
        }),*),*];

        /// Names of all fields, of [`Fields::ESTIMATES`] and of [`Fields::ALL`], for the command
        /// line.
        pub const FIELD_NAMES: &str = concat!($($(stringify!($name), ", "),*),*, "estimates, all");
    };
}
frame_fields!(fields);

impl Fields {
    /// Every field.
    pub const ALL: Self = Self::all();
    /// A controller's choice: force, contact position, per-sensor forces and slip.
    pub const ESTIMATES: Self =
        Self::SENSORS.union(Self::FORCE).union(Self::POINT).union(Self::SLIP);
}

macro_rules! bits {
    (
        flags { $($FLAG:ident $flag:literal $name:literal $kind:ident $title:literal $meaning:literal $remedy:literal)* }
        estimators { $($RAN:ident $ran:literal $ran_name:literal $built:expr, $ran_meaning:literal)* }
    ) => {
        /// State of a frame and the estimators that ran for it, one bit each. Append bits, never
        /// renumber.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[serde(transparent)]
        pub struct Status(pub u32);

        bitflags::bitflags! {
            impl Status: u32 {
                $(
                    #[doc = concat!("Bit ", $flag, ": ", $meaning, ".")]
                    const $FLAG = 1 << $flag;
                )*
                $(
                    #[doc = concat!("Bit ", $ran, ": ", $ran_meaning, ".")]
                    const $RAN = 1 << $ran;
                )*
            }
        }

        /// Every bit.
        pub const BITS: &[Bit] = &[
            $(Bit {
                status: Status::$FLAG,
                name: $name,
                constant: stringify!($FLAG),
                kind: Kind::$kind,
                title: $title,
                meaning: $meaning,
                remedy: $remedy,
            },)*
            $(Bit {
                status: Status::$RAN,
                name: $ran_name,
                constant: stringify!($RAN),
                kind: Kind::Estimator,
                title: "",
                meaning: $ran_meaning,
                remedy: "",
            },)*
        ];

        impl Status {
            /// Estimators that this build contains.
            pub const BUILT: Self = Self(0 $(| if $built { 1 << $ran } else { 0 })*);
        }
    };
}
status_bits!(bits);

/// Returns the set bits of `status` with their names and meanings.
pub fn named(status: Status) -> impl Iterator<Item = &'static Bit> {
    BITS.iter().filter(move |bit| status.contains(bit.status))
}
