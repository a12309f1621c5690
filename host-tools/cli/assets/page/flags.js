// What each status flag means and what to do. A flag that is not listed is shown by its name.
export const FLAGS = {
  "contact": ["good", "Something touches the finger", ""],
  "uncalibrated": ["warn", "Uncalibrated", "No force can be given. Upload a calibration: taxel calibrate upload --calibration finger.toml."],
  "saturated": ["bad", "A taxel is clipped", "Too much light: shade the finger, or press less. Its force is withheld."],
  "dead-taxel": ["bad", "A taxel sees no light", "Look at its LED and phototransistor. The force is withheld; the point leaves it out."],
  "bridge-fault": ["bad", "A force sensor's bridge is broken", "A midpoint is near a rail: look at its wiring. That sensor's force is withheld."],
  "out-of-range": ["warn", "Outside what was calibrated", "Press less, or calibrate further out. The forces that need it are withheld."],
  "overrun": ["warn", "Scans were lost", "The finger was busy (flash, or a rate too high for it)."],
  "biased": ["good", "A bias taken on command is in force", ""],
  "stuck-channel": ["bad", "A channel does not change any more", "Look at its wiring. It is left out as a dead one is."],
  "not-single": ["warn", "Not a single contact", "An edge, or two objects: trust the normal force, not the one point."],
  "disagree": ["warn", "Matrix and force sensors disagree", "The surer one is given. Take a bias; if it stays, calibrate again."],
  "slip-warning": ["warn", "About to slip", "Grip harder."],
  "slides": ["bad", "It slides", "Grip harder."],
  "temperature": ["warn", "Warmer or colder than was calibrated", "Record it at rest while it warms, and fit again with that recording."],
  "noisy": ["warn", "A force sensor is noisy", "Look at its supply and its wires."],
};
