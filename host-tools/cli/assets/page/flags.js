// Meaning of each status flag, and the fix. Flags that are not listed are shown by name.
export const FLAGS = {
  // schema: flags (from src/frame/schema.rs by `cargo xtask protocol`)
  "contact": ["good", "Something touches the finger", ""],
  "uncalibrated": ["warn", "Uncalibrated", "Upload a calibration: taxel calibrate upload --calibration finger.toml."],
  "saturated": ["bad", "A taxel is clipped: the matrix gives no force", "Sun or a lamp on the skin, or too much pressure: shade it, press less."],
  "dead-taxel": ["bad", "A taxel sees no light, is stuck, jumps or is noisy alone: the matrix gives no force", "taxel self-test; check its LED, phototransistor and row driver."],
  "bridge-fault": ["bad", "A force sensor's bridge is broken, is stuck, jumps or is noisy alone: it gives no force", "An open or shorted arm: check that sensor's wires."],
  "out-of-range": ["warn", "Outside the calibrated range", "Press less, or calibrate with larger forces."],
  "overrun": ["warn", "Scans were lost", "Expected while the flash is written (an upload); else set a lower rate."],
  "biased": ["good", "A bias taken on command is active", "taxel bias clear returns to the calibration's."],
  "stuck-channel": ["bad", "A channel no longer changes: it is left out", "Check its wiring, as for a dead taxel or bridge."],
  "not-single": ["warn", "Not a single contact", "An edge or two objects: trust the normal force, not the one point."],
  "disagree": ["warn", "Matrix and force sensors disagree", "taxel bias take; if it stays, calibrate again."],
  "slip-warning": ["warn", "About to slip", "Grip harder, with at least grip_n."],
  "slides": ["bad", "It slides", "Grip harder, or let go."],
  "temperature": ["warn", "Warmer or colder than was calibrated", "Record the finger at rest while it warms (scene warm-up) and add that to calibrate fit."],
  "noisy": ["warn", "A force sensor is noisy", "Check supply and wires; a motor nearby."],
  "row-held": ["warn", "A row is held on: no estimates", "It ends with the program that asked for it (taxel record --hold-row 0 --out row.csv)."],
  // schema: end
};
