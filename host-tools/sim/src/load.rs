//! Loads on the skin, one for each contact.

/// Largest number of simultaneous contacts.
pub const MOST_CONTACTS: usize = 4;

/// Force and torsion on the skin at one contact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Contact point in mm.
    pub point: [f64; 2],
    /// Force in newtons, z into the skin.
    pub force: [f64; 3],
    /// Moment about the normal at the contact point in N mm, from x to y.
    pub torsion: f64,
    /// Whether the contact slips, because friction carries less than the requested force.
    pub slip: bool,
}

/// Loads on the skin at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contacts {
    loads: [Load; MOST_CONTACTS],
    count: usize,
}

impl Contacts {
    /// Loads, one for each contact.
    #[must_use]
    pub fn loads(&self) -> &[Load] {
        self.loads.get(..self.count).unwrap_or(&self.loads)
    }

    /// Whether nothing touches.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Adds a load; a load beyond [`MOST_CONTACTS`] is ignored.
    pub fn push(&mut self, load: Load) {
        if let Some(place) = self.loads.get_mut(self.count) {
            *place = load;
            self.count += 1;
        }
    }

    /// Equivalent single load on a rigid finger; `None` where nothing touches.
    ///
    /// Its force is the sum of the forces, and its point the mean of the contact points weighted by
    /// normal force. The remaining moment about the normal is its torsion. The load slips if any of
    /// the contacts slips.
    #[must_use]
    pub fn whole(&self) -> Option<Load> {
        let (first, others) = self.loads().split_first()?;
        if others.is_empty() {
            return Some(*first);
        }
        let sum = |value: &dyn Fn(&Load) -> f64| self.loads().iter().map(value).sum::<f64>();
        let force = [sum(&|l| l.force[0]), sum(&|l| l.force[1]), sum(&|l| l.force[2])];
        let [x, y] = [sum(&|l| l.point[0] * l.force[2]), sum(&|l| l.point[1] * l.force[2])]
            .map(|moment| moment / force[2]);
        let torsion =
            sum(&|l| l.torsion + (l.point[0] - x) * l.force[1] - (l.point[1] - y) * l.force[0]);
        let slip = self.loads().iter().any(|load| load.slip);
        Some(Load { point: [x, y], force, torsion, slip })
    }

    /// Returns the contacts with all forces and moments multiplied by `times`.
    #[must_use]
    pub fn scaled(mut self, times: f64) -> Self {
        for load in &mut self.loads {
            load.force = load.force.map(|force| force * times);
            load.torsion *= times;
        }
        self
    }
}

impl From<Load> for Contacts {
    fn from(load: Load) -> Self {
        let mut contacts = Self::default();
        contacts.push(load);
        contacts
    }
}
