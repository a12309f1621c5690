//! Tests of the committed schematic: its netlist against the firmware's pins and the page.

use std::collections::{BTreeMap, BTreeSet};

use scan_plan::finger::REFERENCE;
use scan_plan::pins::G431;

use super::board::{net, ohms, port};
use super::netlist::{Netlist, Node, PartPin, parse};
use crate::run::{answer, lines, program, root};

#[test]
fn controllers_nets_are_the_firmwares_pins() {
    let netlist = Netlist::committed();
    let chip = netlist.part("STM32G431CBT6");
    let ports =
        netlist.names.iter().filter(|((part, _), name)| part == chip && name.starts_with('P'));
    let mut used = 0;
    for ((part, number), name) in ports {
        let on = netlist.net(part, number);
        match G431.iter().find(|pin| port(pin) == *name) {
            Some(pin) => {
                assert_eq!(on, net(pin), "{name}");
                assert!(netlist.nets[on].len() > 1, "{name} leads nowhere");
                used += 1;
            }
            None => assert!(netlist.open.contains(&(part.clone(), number.clone())), "{name}"),
        }
    }
    assert_eq!(used, G431.len());
}

#[test]
fn columns_and_rows_are_the_reference_fingers() {
    let netlist = Netlist::committed();
    let (pair, column) = (REFERENCE.pair, REFERENCE.column);
    for index in 0..4 {
        let name = format!("COLUMN_{index}");
        let out = netlist.across("100 Ω", &name);
        let [out] = out[..] else { panic!("{name}: {out:?}") };
        let minus = netlist.across(&format!("{} kΩ 0.1 % 25 ppm", column.feedback_ohm / 1e3), out);
        let [minus] = minus[..] else { panic!("{name}: {minus:?}") };
        assert_eq!(netlist.across(&format!("{:.0} pF", 1e12 * column.feedback_f), out), [minus]);
        assert_eq!(netlist.across(pair.phototransistor, minus), ["GND"; 4], "{name}");
        let amplifier = netlist.part(column.amplifier);
        let of = |net: &str| {
            let pins = netlist.nets[net].iter().filter(|(part, _)| part == amplifier);
            pins.map(|(_, number)| number.as_str()).collect::<Vec<_>>()
        };
        let units = [("1", "2", "3"), ("7", "6", "5"), ("8", "9", "10"), ("14", "13", "12")];
        let unit = units.iter().find(|(pin, ..)| of(out).contains(pin)).unwrap();
        assert!(of(minus).contains(&unit.1) && of("COLUMN_REFERENCE").contains(&unit.2), "{name}");

        let gate = netlist.across("100 Ω", &format!("LED_ROW_{index}"));
        let [gate] = gate[..] else { panic!("row {index}: {gate:?}") };
        assert_eq!(netlist.across("100 kΩ", gate), ["GND"]);
        let switch = netlist.nets[gate].iter().find(|(part, _)| netlist.values[part] == "BSS138");
        let (switch, number) = switch.unwrap();
        assert_eq!((number.as_str(), netlist.net(switch, "2")), ("1", "GND"));
        let anodes = netlist.across(pair.led, netlist.net(switch, "3"));
        assert_eq!(anodes.len(), 4);
        for anode in anodes {
            assert_eq!(netlist.across(&format!("{} 1 %", ohms(pair.led_ohm)), anode), ["VDDA"]);
        }
    }
    for (ohm, supply) in column.divider_ohm.into_iter().zip(["VDDA", "GND"]) {
        assert_eq!(netlist.across(&format!("{} 0.1 %", ohms(ohm)), "COLUMN_REFERENCE"), [supply]);
    }
}

#[test]
fn multiplexers_carry_each_sensor_to_its_pins() {
    let netlist = Netlist::committed();
    // Inputs 0 to 3 and the common pin of both halves, of the two chips in turn (74HC4052).
    let halves = [(["12", "14", "15", "11"], "13"), (["1", "5", "2", "4"], "3")];
    let chips: Vec<_> = netlist.values.iter().filter(|(_, value)| *value == "74HC4052PW").collect();
    assert_eq!(chips.len(), 2);
    for ((chip, _), letters) in chips.into_iter().zip([["A", "B"], ["C", "D"]]) {
        assert_eq!(
            (netlist.net(chip, "10"), netlist.net(chip, "9")),
            ("MULTIPLEXER_ADDRESS_0", "MULTIPLEXER_ADDRESS_1")
        );
        assert_eq!(["6", "7", "8"].map(|number| netlist.net(chip, number)), ["GND"; 3]);
        for ((inputs, common), letter) in halves.into_iter().zip(letters) {
            assert_eq!(netlist.net(chip, common), format!("MIDPOINT_{letter}"));
            for (sensor, input) in inputs.into_iter().enumerate() {
                let on = netlist.net(chip, input);
                let ends = &netlist.nets[on];
                let end =
                    ends.iter().find(|(part, _)| part == &format!("J{}", sensor + 1)).unwrap();
                assert_eq!((ends.len(), netlist.names[end].as_str()), (2, letter), "{on}");
            }
        }
    }
}

#[test]
fn parts_are_those_of_the_bill_of_materials() {
    let page = std::fs::read_to_string(root().join("docs/boards/stm32g431.md")).unwrap();
    let bill = page.split("## Bill of materials").nth(1).unwrap().split("##").next().unwrap();
    let mut billed: BTreeMap<String, u32> = BTreeMap::new();
    for row in bill.lines().filter(|line| line.starts_with("| ")).skip(1) {
        let cells: Vec<&str> = row.trim_matches('|').split(" | ").map(str::trim).collect();
        let counts: Vec<u32> =
            cells[2].split([';', '+']).filter_map(|n| n.trim().parse().ok()).collect();
        // Passive parts by their value, all others by their order name.
        let text = format!("{}, {}", cells[0], cells[1]);
        let text = text
            .split(" (")
            .map(|part| part.split_once(')').map_or(part, |(_, rest)| rest))
            .collect::<String>();
        let passive = text.split([',', ';']).filter_map(value).collect::<Vec<_>>();
        if cells[0].starts_with("force sensor,") || counts.is_empty() {
            continue;
        }
        let name = cells[1].split([' ', ',']).next().unwrap();
        if value(cells[0]).is_none() && name.parse::<f64>().is_err() {
            *billed.entry(name.to_owned()).or_default() += counts[0];
        }
        for (i, value) in passive.into_iter().enumerate() {
            *billed.entry(value).or_default() += counts.get(i).copied().unwrap_or(counts[0]);
        }
    }
    let mut drawn: BTreeMap<String, u32> = BTreeMap::new();
    let netlist = Netlist::committed();
    for (reference, text) in &netlist.values {
        // The probe's pads are no part.
        if text != "TC2030-NL" {
            let name =
                if reference.starts_with(['R', 'C']) { value(text).unwrap() } else { text.clone() };
            *drawn.entry(name).or_default() += 1;
        }
    }
    assert_eq!(drawn, billed);
    assert!(drawn.values().sum::<u32>() > 100);
}

/// Whether a number is a value of E96, or of E24, in which capacitors are sold too.
fn is_in_a_series(number: f64) -> bool {
    const E24: [u32; 24] = [
        10, 11, 12, 13, 15, 16, 18, 20, 22, 24, 27, 30, 33, 36, 39, 43, 47, 51, 56, 62, 68, 75, 82,
        91,
    ];
    let digits = (number / 10f64.powf(number.log10().floor()) * 1e6).round() as u32;
    let e96 = |i: i32| (10f64.powf(f64::from(i) / 96.0) * 100.0).round() as u32;
    E24.iter().any(|two| two * 100_000 == digits) || (0..96).any(|i| e96(i) * 10_000 == digits)
}

#[test]
fn each_part_has_footprint_and_order_number() {
    let netlist = Netlist::committed();
    let folder = root().join("boards/stm32g431/hardware");
    for (reference, text) in &netlist.values {
        let footprint = &netlist.footprints[reference];
        let (library, name) = footprint.split_once(':').unwrap_or_default();
        let own = folder.join(format!("{library}.pretty/{name}.kicad_mod"));
        assert!(
            !name.is_empty() && (library != "taxel" || own.exists()),
            "{reference} {footprint}"
        );
        if !reference.starts_with(['R', 'C']) {
            // An order name is one word with a digit.
            let named = text.contains(|c: char| c.is_ascii_digit()) && !text.contains(' ');
            assert!(named, "{reference}: {text}");
            continue;
        }
        let number = value(text).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!(is_in_a_series(number), "{reference}: {text} is not sold");
    }
    assert!(!is_in_a_series(70.0) && is_in_a_series(69.8) && is_in_a_series(91.0));
}

#[test]
fn pads_of_neighbouring_rows_stay_apart() {
    let pair = REFERENCE.pair;
    let pitch = f64::from(taxel::scan::PITCH.0);
    // Between rows in a package's length; between pairs in its width. 0.15 mm is what is made.
    assert!(pitch - pair.pads_mm() >= 0.15, "{}", pair.pads_mm());
    assert!(pitch - pair.separation_mm - pair.package_mm[1] >= 0.15);
    let text = super::footprint::file();
    let file = parse(&text);
    let pads: Vec<[f64; 2]> = file
        .all("pad")
        .map(|pad| [pad.one("at").number(1), pad.one("size").number(1) / 2.0])
        .collect();
    let span = pads.iter().map(|[at, half]| at.abs() + half).fold(0.0, f64::max) * 2.0;
    assert!(pads.len() == 2 && (span - pair.pads_mm()).abs() < 1e-9, "{text}");
    assert!(pads.iter().all(|[at, half]| at.abs() - half > 0.25), "{text}");
}

/// Value of a resistor or capacitor at the begin of a text or of its last words, such as `10 kΩ`.
fn value(text: &str) -> Option<String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let units = ["Ω", "kΩ", "pF", "nF", "µF"];
    let found =
        words.windows(2).find(|pair| pair[0].parse::<f64>().is_ok() && units.contains(&pair[1]));
    found.map(|pair| pair.join(" "))
}

#[test]
fn schematic_keeps_the_electrical_rules() {
    let netlist = Netlist::committed();
    for (pin, kind) in &netlist.kinds {
        let on = netlist.net(&pin.0, &pin.1);
        let others = netlist.nets[on].iter().filter(|other| *other != pin);
        let kinds: Vec<&str> = others.map(|other| netlist.kinds[other].as_str()).collect();
        if netlist.open.contains(pin) {
            assert!(kinds.is_empty(), "{pin:?} is marked open and is on {on}");
            continue;
        }
        assert!(!kinds.is_empty(), "{pin:?} leads nowhere");
        if kind == "output" || kind == "power_out" {
            assert!(
                !kinds.contains(&"output") && !kinds.contains(&"power_out"),
                "{on}: two outputs"
            );
        }
        // A supply comes from the regulator, the bead behind it or the cable.
        if kind == "power_in" {
            assert!(["VDD", "VDDA", "VBUS", "GND"].contains(&on), "{pin:?} is supplied by {on}");
        }
        let bad = kind == "input" && kinds.iter().all(|other| *other == "input");
        assert!(!bad, "{on}: no source");
    }
    assert_eq!(netlist.across(REFERENCE.supply.bead, "VDD"), ["VDDA"]);
    assert!(netlist.nets["VDD"].iter().any(|pin| netlist.kinds[pin] == "power_out"));
}

#[test]
fn kicads_rule_check_and_netlist_agree() {
    // Versions before 8 have no rule check on the command line.
    let version = answer(program("kicad-cli", &root()).arg("version"));
    let version =
        version.as_deref().and_then(|v| v.split('.').next()).and_then(|v| v.parse::<u32>().ok());
    if version.is_none_or(|version| version < 8) {
        eprintln!("left out: kicad-cli 8 or later is not installed (`apt-get install kicad`)");
        return;
    }
    let out = crate::run::target().join("kicad");
    std::fs::create_dir_all(&out).unwrap();
    let run = |arguments: &[&str], file: &str| {
        let mut command = program("kicad-cli", &root().join("boards/stm32g431/hardware"));
        command
            .arg("sch")
            .args(arguments)
            .arg("--output")
            .arg(out.join(file))
            .arg("taxel.kicad_sch");
        lines(&mut command).unwrap_or_else(|| panic!("kicad-cli sch {arguments:?} fails"));
        std::fs::read_to_string(out.join(file)).unwrap()
    };
    let report = run(&["erc", "--severity-error"], "erc.rpt");
    assert!(report.contains("ERC messages: 0"), "{report}");
    let exported = parse(&run(&["export", "netlist", "--format", "kicadsexpr"], "taxel.net"));
    let netlist = Netlist::committed();
    let theirs: BTreeSet<BTreeSet<PartPin>> = exported
        .one("nets")
        .all("net")
        .map(|net| {
            let of = |node: &Node, key: &str| node.one(key).list()[1].word().to_owned();
            net.all("node").map(|node| (of(node, "ref"), of(node, "pin"))).collect()
        })
        .collect();
    let ours: BTreeSet<BTreeSet<PartPin>> = netlist.nets.into_values().collect();
    assert_eq!(ours, theirs);
}

#[test]
fn reader_finds_nets_shorts_and_open_pins() {
    let two = "(symbol (lib_id \"r\") (at 0 0 90) (unit 1) (property \"Reference\" \"R1\") (property \"Value\" \"1 Ω\") \
               (property \"Footprint\" \"\"))";
    let sheet = |rest: &str| {
        format!(
            "(kicad_sch (lib_symbols (symbol \"r\" (symbol \"r_1_1\" (pin passive line (at 0 1 0) (name \"~\") (number \"1\")) \
             (pin passive line (at 0 -1 0) (name \"~\") (number \"2\"))))) {two} {rest})"
        )
    };
    let labelled =
        "(wire (pts (xy -1 0) (xy -5 0))) (label \"A\" (at -5 0 0)) (no_connect (at 1 0))";
    let netlist = Netlist::read(&sheet(labelled));
    assert_eq!(netlist.net("R1", "1"), "A");
    assert!(netlist.net("R1", "2").starts_with('~') && netlist.open.len() == 1);
    let short = format!("{labelled} (wire (pts (xy -5 0) (xy -5 9))) (label \"B\" (at -5 9 0))");
    assert!(std::panic::catch_unwind(|| Netlist::read(&sheet(&short))).is_err());
}
