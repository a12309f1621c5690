//! Tests of traces: they read back as written, and every fault is an error in one line.

use proptest::prelude::*;
use taxel::scan::{Codes, Midpoints, Scan, TaxelCodes};
use taxel::units::{Code, FullScale, Micros};
use taxel_files::trace::{
    self, Others, Sample, TraceHeader, TraceReader, TraceWriter, Truth, is_trace,
};

fn read(text: &str) -> Result<Vec<Sample>, String> {
    TraceReader::new(text.as_bytes(), "trace.csv")
        .and_then(Iterator::collect)
        .map_err(|error| error.to_string())
}

fn header() -> String {
    let lit = (0..4).flat_map(|r| (0..4).map(move |c| format!("lit_r{r}c{c}")));
    let dark = (0..4).map(|c| format!("dark_c{c}"));
    let names: Vec<String> = ["t_us".to_owned()].into_iter().chain(lit).chain(dark).collect();
    names.join(",")
}

fn line(time: &str, code: &str) -> String {
    format!("{time}{}", format!(",{code}").repeat(20))
}

#[test]
fn trace_is_read_with_columns_in_any_order() {
    let text = format!("{},fz_n\n{},0.5\n", header(), line("0", "7"));
    let sample = read(&text).unwrap()[0];
    assert_eq!(sample.truth.force, [None, None, Some(0.5)]);
    let mut names: Vec<String> = header().split(',').map(str::to_owned).collect();
    let mut cells: Vec<String> = (0..21).map(|i| i.to_string()).collect();
    let straight = read(&format!("{}\n{}\n", names.join(","), cells.join(","))).unwrap();
    names.reverse();
    cells.reverse();
    let reversed = read(&format!("{}\n{}\n", names.join(","), cells.join(","))).unwrap();
    assert_eq!(straight, reversed);
    assert_eq!(straight[0].scan.codes.taxels.unwrap().lit[0][1], Code(2));
}

/// A recording of `taxel record --fields codes,force` from a finger without sensors and
/// temperature.
#[test]
fn recording_is_a_trace_without_truth() {
    let lit: Vec<String> = (0..16).map(|k| format!("lit_r{}c{}", k / 4, k % 4)).collect();
    let names = format!(
        "t_us,seq,status,contact,fz_n,{},dark_c0,dark_c1,dark_c2,dark_c3,bridge_s0_a,bridge_s0_b,\
         bridge_s0_c,bridge_s0_d,aux_vref,aux_temp",
        lit.join(",")
    );
    let row = |t: u32| format!("{t},{t},1,1,0.5,{}9,9,9,9,,,,,700,", "100,".repeat(16));
    let text = format!("# serial=F\n# full_scale=65535\n{names}\n{}\n{}\n", row(250), row(500));
    let samples: Vec<Sample> =
        TraceReader::new(text.as_bytes(), "f.csv").unwrap().map(Result::unwrap).collect();
    assert_eq!(samples.len(), 2);
    for sample in samples {
        let codes = sample.scan.codes;
        assert_eq!(codes.taxels.unwrap().lit[3][3], Code(100));
        assert_eq!((codes.bridges, codes.temperature), ([None; 4], None));
        assert_eq!(codes.reference, Some(Code(700)));
        assert_eq!(sample.truth, Truth::default(), "the finger's own word is no truth");
    }
    // A channel lost midway is still an error.
    let torn = text.replacen("500,500,1,1,0.5,100", "500,500,1,1,0.5,", 1);
    let mut reader = TraceReader::new(torn.as_bytes(), "f.csv").unwrap();
    assert!(reader.next().unwrap().is_ok() && reader.next().unwrap().is_err());
}

#[test]
fn error_is_one_line_with_line_column_and_mend() {
    let good = line("0", "7");
    let header = header();
    let cases = [
        (
            String::new(),
            "trace.csv: no header: the file is empty; a trace starts with a line of column names, `t_us,lit_r0c0,…`",
        ),
        (
            format!("{}\n{good}\n", header.replace(",lit_r1c2", ",lost")),
            "trace.csv:1: `lit_r1c2`: the column is missing; add it, or leave out all of lit_r0c0 … dark_c3",
        ),
        (
            format!("{}\n{good}\n", header.replace("t_us", "time")),
            "trace.csv:1: `t_us`: the column is missing; a trace needs device time in microseconds",
        ),
        (
            "t_us,fz_n\n0,1\n".to_owned(),
            "trace.csv:1: `lit_r0c0`: the column is missing; a trace has lit_r0c0…lit_r3c3 with dark_c0…dark_c3, or bridge_s0_a…, or both",
        ),
        (
            format!("{}\n{good}\n", header.replace("lit_r1c2", "lit_r1c1")),
            "trace.csv:1: `lit_r1c1`: duplicate column; remove one of them",
        ),
        (
            format!("{header}\n{good}\n{}\n", line("250", "seven")),
            "trace.csv:3: `lit_r0c0`: expected a whole code 0…4095, found `seven`; codes are what the ADC read; a sensor that is absent has no column",
        ),
        (
            format!("{header}\n{}\n", line("0", "NaN")),
            "trace.csv:2: `lit_r0c0`: expected a whole code 0…4095, found `NaN`; codes are what the ADC read; a sensor that is absent has no column",
        ),
        (
            format!("{header}\n{}\n", line("0", "30000")),
            "trace.csv:2: `lit_r0c0`: code 30000 is above full scale 4095; if the codes are scaled to 16 bits, make `# full_scale=65535` the first line",
        ),
        (
            format!("{header}\n{good}\n250,7,7"),
            "trace.csv:3: 3 fields where the header has 21; complete or remove the line; a recording cut short often ends in one",
        ),
        (
            format!("# full_scale=0\n{header}\n{good}\n"),
            "trace.csv:1: `full_scale`: expected a whole number 1…65535, found `0`; write `# full_scale=4095` or `# full_scale=65535`",
        ),
        (
            format!("{header}\n{good}\n{good}\n"),
            "trace.csv:3: `t_us`: time 0 does not come after 0; sort the lines by t_us",
        ),
        (
            format!("{header}\n{}\n{}\n", line("12406000", "7"), line("96000", "7")),
            "trace.csv:3: `t_us`: time 96000 does not come after 12406000; the finger restarted here; give FILE@..12 (seconds)",
        ),
        (
            format!("{header}\n{}\n", line("1.5", "7")),
            "trace.csv:2: `t_us`: expected whole microseconds, found `1.5`; times are counted from 0 upwards, without decimals",
        ),
        (
            format!("{header},fz_n\n{good},NaN\n"),
            "trace.csv:2: `fz_n`: expected a finite number, found `NaN`; leave the cell empty where the value is not known",
        ),
        (
            format!("{header},contact\n{good},yes\n"),
            "trace.csv:2: `contact`: expected 0 or 1, found `yes`; leave the cell empty where it is not known",
        ),
    ];
    for (text, message) in cases {
        assert_eq!(read(&text).unwrap_err(), message);
    }
}

#[test]
fn line_numbers_match_an_editor() {
    let text =
        format!("\u{feff}# full_scale=65535\r\n\r\n{}\r\n\r\n\r\n{}\r\n", header(), line("0", "x"));
    let error = read(&text).unwrap_err();
    assert!(error.starts_with("trace.csv:6: `lit_r0c0`: expected a whole code 0…65535"), "{error}");
}

#[test]
fn header_alone_is_an_empty_trace() {
    assert_eq!(read(&header()), Ok(vec![]));
}

#[test]
fn error_names_missing_file() {
    let error = TraceReader::open("no/such.csv").err().unwrap().to_string();
    assert!(error.starts_with("no/such.csv: "), "{error}");
    assert!(error.ends_with("; check the path"), "{error}");
}

#[test]
fn columns_that_no_trace_has_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    std::fs::write(&path, "t_us,lit_r0c0,fz_n,s0_fx_n,room_c,operator\n").unwrap();
    let unknown = vec!["room_c".to_owned(), "operator".to_owned()];
    assert_eq!(trace::other_columns(&path).unwrap(), Others::Unknown(unknown));
    std::fs::write(&path, "t_us,seq,lit_r0c0,fz_n\n").unwrap();
    assert_eq!(trace::other_columns(&path).unwrap(), Others::Frames);
}

#[test]
fn header_distinguishes_trace_from_other_csv() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    std::fs::write(&path, format!("# full_scale=65535\n{}\n", header())).unwrap();
    assert_eq!(is_trace(&path), Ok(true));
    std::fs::write(&path, "t_s,m0,force_n\n0,1,2\n").unwrap();
    assert_eq!(is_trace(&path), Ok(false));
}

fn sample(time: u64, code: u16) -> Sample {
    let code = Code(code);
    let midpoints = Midpoints { a: code, b: Code(1), c: Code(2), d: Code(3) };
    Sample {
        scan: Scan {
            time: Micros(time),
            lost: 0,
            codes: Codes {
                full_scale: FullScale::BITS_16,
                taxels: Some(TaxelCodes { lit: [[code; 4]; 4], dark: [Code(5); 4] }),
                bridges: [Some(midpoints), None, None, Some(midpoints)],
                reference: Some(code),
                temperature: None,
            },
        },
        truth: Truth {
            force: [Some(0.25), Some(-0.5), Some(1.0)],
            point: [None, Some(-2.0)],
            point_sigma: None,
            torsion: Some(0.0),
            contact: Some(true),
            slip: Some(false),
            sensors: [[Some(0.125); 3], [None; 3], [None; 3], [Some(-0.125); 3]],
        },
    }
}

#[test]
fn written_trace_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    let samples = [sample(0, 65535), sample(u64::from(u32::MAX) * 3, 0)];
    let header = TraceHeader {
        full_scale: FullScale::BITS_16,
        rows: 4,
        bridges: [true, false, false, true],
        reference: true,
        temperature: false,
        truth: true,
        sensor_truth: true,
    };
    let mut writer = TraceWriter::create(&path, header).unwrap();
    samples.iter().for_each(|sample| writer.write(sample).unwrap());
    writer.finish().unwrap();
    let read: Vec<Sample> = TraceReader::open(&path).unwrap().map(Result::unwrap).collect();
    assert_eq!(read, samples);
}

#[test]
fn line_of_taxels_reads_dark_in_other_rows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.csv");
    let header = TraceHeader {
        full_scale: FullScale::BITS_16,
        rows: 1,
        bridges: [false; 4],
        reference: false,
        temperature: false,
        truth: false,
        sensor_truth: false,
    };
    let mut written = sample(0, 700).scan.codes.taxels.unwrap();
    written.lit[0] = [1, 2, 3, 4].map(|n| Code(9000 + n));
    let mut line = sample(0, 700);
    line.scan.codes.taxels = Some(written);
    let mut writer = TraceWriter::create(&path, header).unwrap();
    writer.write(&line).unwrap();
    writer.finish().unwrap();
    let columns = std::fs::read_to_string(&path).unwrap().lines().nth(1).unwrap().to_owned();
    assert_eq!(columns, "t_us,lit_r0c0,lit_r0c1,lit_r0c2,lit_r0c3,dark_c0,dark_c1,dark_c2,dark_c3");
    let reader = TraceReader::open(&path).unwrap();
    assert_eq!(reader.channels().rows, 1);
    let codes = reader.map(Result::unwrap).next().unwrap().scan.codes.taxels.unwrap();
    assert_eq!((codes.lit[0], codes.dark), (written.lit[0], written.dark));
    assert_eq!(codes.lit[1..], [codes.dark; 3]);
}

proptest! {
    #[test]
    fn reader_accepts_any_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
        if let Ok(reader) = TraceReader::new(&bytes[..], "x") {
            for _ in reader.take(100) {}
        }
    }

    #[test]
    fn reader_accepts_any_mangled_trace(
        at in 0usize..400, with in any::<u8>(), cut in 0usize..400,
    ) {
        let mut bytes =
            format!("# full_scale=65535\n{},fz_n,slip\n{},0.1,1\n", header(), line("0", "7"))
                .into_bytes();
        let at = at % bytes.len();
        bytes[at] = with;
        bytes.truncate(cut.max(1));
        if let Ok(reader) = TraceReader::new(&bytes[..], "x") {
            for _ in reader.take(100) {}
        }
    }
}
