//! Netlist of a KiCad schematic, read from its file.
//!
//! The reader knows nothing of the drawing: it joins wires, pins and labels by their places alone.

use std::collections::{BTreeMap, BTreeSet};

use crate::run::root;

/// Node of an S-expression.
#[derive(Clone, Debug)]
pub(super) enum Node {
    Word(String),
    List(Vec<Node>),
}

impl Node {
    pub(super) fn list(&self) -> &[Node] {
        if let Self::List(nodes) = self { nodes } else { &[] }
    }

    pub(super) fn word(&self) -> &str {
        if let Self::Word(word) = self { word } else { "" }
    }

    pub(super) fn name(&self) -> &str {
        self.list().first().map_or("", Self::word)
    }

    /// Lists of this name within the list.
    pub(super) fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Node> {
        self.list().iter().filter(move |node| node.name() == name)
    }

    pub(super) fn one<'a>(&'a self, name: &'a str) -> &'a Node {
        self.all(name).next().unwrap_or_else(|| panic!("no {name} in {}", self.name()))
    }

    pub(super) fn number(&self, index: usize) -> f64 {
        self.list()[index].word().parse().unwrap()
    }

    /// Place in hundredths of a millimetre.
    pub(super) fn place(&self) -> (i64, i64) {
        ((self.number(1) * 100.0).round() as i64, (self.number(2) * 100.0).round() as i64)
    }
}

pub(super) fn parse(text: &str) -> Node {
    let mut stack = vec![Vec::new()];
    let mut rest = text.chars().peekable();
    while let Some(c) = rest.next() {
        match c {
            '(' => stack.push(Vec::new()),
            ')' => {
                let list = stack.pop().unwrap();
                stack.last_mut().unwrap().push(Node::List(list));
            }
            '"' => {
                let word: String = rest.by_ref().take_while(|c| *c != '"').collect();
                stack.last_mut().unwrap().push(Node::Word(word));
            }
            c if c.is_whitespace() => {}
            c => {
                let mut word = c.to_string();
                while let Some(c) = rest.next_if(|c| !c.is_whitespace() && !"()".contains(*c)) {
                    word.push(c);
                }
                stack.last_mut().unwrap().push(Node::Word(word));
            }
        }
    }
    stack.pop().unwrap().pop().unwrap()
}

/// Pin of a part: reference and number.
pub(super) type PartPin = (String, String);

/// Netlist of a schematic.
pub(super) struct Netlist {
    /// Value of each part, its units taken together.
    pub(super) values: BTreeMap<String, String>,
    /// Footprint of each part.
    pub(super) footprints: BTreeMap<String, String>,
    /// Pins of each net; a net without a label has the name of a place.
    pub(super) nets: BTreeMap<String, BTreeSet<PartPin>>,
    /// Names of pins on their symbols.
    pub(super) names: BTreeMap<PartPin, String>,
    /// Electrical types of pins.
    pub(super) kinds: BTreeMap<PartPin, String>,
    /// Pins that stay open on purpose.
    pub(super) open: BTreeSet<PartPin>,
}

impl Netlist {
    pub(super) fn read(text: &str) -> Self {
        let sheet = parse(text);
        let library: BTreeMap<&str, &Node> =
            sheet.one("lib_symbols").all("symbol").map(|s| (s.list()[1].word(), s)).collect();
        let mut netlist = Self {
            values: BTreeMap::new(),
            footprints: BTreeMap::new(),
            nets: BTreeMap::new(),
            names: BTreeMap::new(),
            kinds: BTreeMap::new(),
            open: BTreeSet::new(),
        };
        let mut wires: Vec<[(i64, i64); 2]> = Vec::new();
        for wire in sheet.all("wire") {
            let ends: Vec<_> = wire.one("pts").all("xy").map(Node::place).collect();
            wires.push([ends[0], ends[1]]);
        }
        let mut labels: BTreeMap<(i64, i64), String> = sheet
            .all("label")
            .map(|l| (l.one("at").place(), l.list()[1].word().to_owned()))
            .collect();
        let mut pins: Vec<((i64, i64), PartPin)> = Vec::new();
        for symbol in sheet.all("symbol") {
            let of = |key: &str| {
                let property = symbol.all("property").find(|p| p.list()[1].word() == key);
                property.unwrap().list()[2].word().to_owned()
            };
            let (reference, value) = (of("Reference"), of("Value"));
            let kind = library[symbol.one("lib_id").list()[1].word()];
            let unit = symbol.one("unit").list()[1].word();
            let at = symbol.one("at");
            let (x, y) = at.place();
            let body =
                kind.all("symbol").filter(|s| s.list()[1].word().ends_with(&format!("_{unit}_1")));
            for pin in body.flat_map(|s| s.all("pin")) {
                let (px, py) = pin.one("at").place();
                let place = match at.number(3) as i32 {
                    90 => (x - py, y - px),
                    180 => (x - px, y + py),
                    270 => (x + py, y + px),
                    _ => (x + px, y - py),
                };
                let name = pin.one("name").list()[1].word().to_owned();
                if kind.all("power").next().is_some() {
                    if value != "PWR_FLAG" {
                        labels.insert(place, value.clone());
                    }
                    continue;
                }
                let key = (reference.clone(), pin.one("number").list()[1].word().to_owned());
                netlist.names.insert(key.clone(), name);
                netlist.kinds.insert(key.clone(), pin.list()[1].word().to_owned());
                pins.push((place, key));
            }
            if kind.all("power").next().is_none() {
                netlist.values.insert(reference.clone(), value);
                netlist.footprints.insert(reference, of("Footprint"));
            }
        }
        netlist.join(&wires, &labels, &pins);
        let open: BTreeSet<_> = sheet.all("no_connect").map(|n| n.one("at").place()).collect();
        netlist.open =
            pins.into_iter().filter(|(at, _)| open.contains(at)).map(|(_, pin)| pin).collect();
        netlist
    }

    /// Joins wires whose ends meet, and gives each pin the net of its place.
    fn join(
        &mut self,
        wires: &[[(i64, i64); 2]],
        labels: &BTreeMap<(i64, i64), String>,
        pins: &[((i64, i64), PartPin)],
    ) {
        // Name of a group of places: each wire moves both its ends to the lesser name.
        let mut group: BTreeMap<(i64, i64), String> = BTreeMap::new();
        let places =
            wires.iter().flatten().chain(pins.iter().map(|(at, _)| at)).chain(labels.keys());
        for place in places {
            let name = labels.get(place).cloned().unwrap_or_else(|| format!("~{place:?}"));
            group.insert(*place, name);
        }
        loop {
            let before = group.clone();
            for [a, b] in wires {
                // Names sort before places, whose names begin with `~`.
                let name = group[a].clone().min(group[b].clone());
                for (from, to) in [(a, b), (b, a)] {
                    let (one, other) = (&group[from], &group[to]);
                    let named = !one.starts_with('~') && !other.starts_with('~');
                    assert!(!named || one == other, "{one} meets {other} at {to:?}");
                }
                group.insert(*a, name.clone());
                group.insert(*b, name);
            }
            if group == before {
                break;
            }
        }
        for (place, pin) in pins {
            self.nets.entry(group[place].clone()).or_default().insert(pin.clone());
        }
    }

    pub(super) fn committed() -> Self {
        let path = root().join("boards/stm32g431/hardware/taxel.kicad_sch");
        Self::read(&std::fs::read_to_string(path).unwrap())
    }

    /// Net of a part's pin.
    pub(super) fn net(&self, reference: &str, number: &str) -> &str {
        let key = (reference.to_owned(), number.to_owned());
        self.nets.iter().find(|(_, pins)| pins.contains(&key)).unwrap().0
    }

    /// Parts of a value on a net, each with its other net.
    pub(super) fn across(&self, value: &str, on: &str) -> Vec<&str> {
        let pins = self.nets[on].iter().filter(|(part, _)| self.values[part].starts_with(value));
        pins.map(|(part, number)| self.net(part, if number == "1" { "2" } else { "1" })).collect()
    }

    /// Part with this value.
    pub(super) fn part(&self, value: &str) -> &str {
        self.values.iter().find(|(_, other)| *other == value).unwrap().0
    }
}
