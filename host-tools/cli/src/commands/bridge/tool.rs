//! Tool frame: another origin and other axes for wrenches than the finger's own.

use std::str::FromStr;

/// Pose of a frame in the finger's, by default the finger's frame itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tool {
    /// Origin in m.
    origin: [f64; 3],
    /// Roll, pitch and yaw in rad, about the finger's fixed x, y and z axes, as in URDF.
    turns: [f64; 3],
}

impl Tool {
    /// Origin in m in the finger's frame.
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }

    /// Returns the rotation as the quaternion x, y, z, w.
    pub fn quaternion(&self) -> [f64; 4] {
        let [(sr, cr), (sp, cp), (sy, cy)] = self.turns.map(|turn| (turn / 2.0).sin_cos());
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    }

    /// Converts force in N and moment in N m from the finger's frame to this one.
    pub fn wrench(&self, [force, moment]: [[f64; 3]; 2]) -> [[f64; 3]; 2] {
        let [px, py, pz] = self.origin;
        let [fx, fy, fz] = force;
        let lever = [py * fz - pz * fy, pz * fx - px * fz, px * fy - py * fx];
        let moment: [f64; 3] = std::array::from_fn(|i| moment[i] - lever[i]);
        let axes = self.axes();
        let along = |vector: [f64; 3]| {
            axes.map(|axis| axis.iter().zip(vector).map(|(axis, part)| axis * part).sum())
        };
        [along(force), along(moment)]
    }

    /// Returns the unit vectors of this frame's axes in the finger's frame.
    fn axes(&self) -> [[f64; 3]; 3] {
        let [(sr, cr), (sp, cp), (sy, cy)] = self.turns.map(f64::sin_cos);
        [
            [cy * cp, sy * cp, -sp],
            [cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr],
            [cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr],
        ]
    }
}

impl FromStr for Tool {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "`{text}` is no pose; write x,y,z in mm, or x,y,z,roll,pitch,yaw in mm and degrees, as in \
                 0,0,-20 or 0,0,-20,0,0,90"
            )
        };
        let numbers: Option<Vec<f64>> = text
            .split(',')
            .map(|number| number.trim().parse().ok().filter(|n: &f64| n.is_finite()))
            .collect();
        let (place, turns) = match numbers.ok_or_else(wrong)?[..] {
            [x, y, z] => ([x, y, z], [0.0; 3]),
            [x, y, z, roll, pitch, yaw] => ([x, y, z], [roll, pitch, yaw]),
            _ => return Err(wrong()),
        };
        Ok(Self { origin: place.map(|mm| mm * 1e-3), turns: turns.map(f64::to_radians) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: [[f64; 3]; 2], b: [[f64; 3]; 2]) -> bool {
        a.as_flattened().iter().zip(b.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-12)
    }

    #[test]
    fn wrench_moves_to_another_origin() {
        let pressed = [[0.0, 0.0, 2.0], [0.0; 3]];
        let aside: Tool = "10,0,0".parse().unwrap();
        assert!(close(aside.wrench(pressed), [[0.0, 0.0, 2.0], [0.0, 0.02, 0.0]]));
        let sheared = [[1.0, 0.0, 0.0], [0.0; 3]];
        let below: Tool = "0,0,20".parse().unwrap();
        assert!(close(below.wrench(sheared), [[1.0, 0.0, 0.0], [0.0, -0.02, 0.0]]));
    }

    #[test]
    fn wrench_turns_into_other_axes() {
        let wrench = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
        let yaw: Tool = "0,0,0,0,0,90".parse().unwrap();
        assert!(close(yaw.wrench(wrench), [[2.0, -1.0, 3.0], [5.0, -4.0, 6.0]]));
        let roll: Tool = "0,0,0,180,0,0".parse().unwrap();
        assert!(close(roll.wrench(wrench), [[1.0, -2.0, -3.0], [4.0, -5.0, -6.0]]));
    }

    #[test]
    fn quaternion_is_the_rotation_of_the_axes() {
        let tool: Tool = "1,2,3,20,-35,130".parse().unwrap();
        let [x, y, z, w] = tool.quaternion();
        assert!((x * x + y * y + z * z + w * w - 1.0).abs() < 1e-12);
        let axes = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)],
            [2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * w)],
        ];
        let found = tool.axes();
        assert!(close(axes, [found[0], found[1]]), "{axes:?} {found:?}");
    }

    #[test]
    fn malformed_pose_is_an_error_with_an_example() {
        for text in ["", "1,2", "1,2,x", "1,2,3,4", "1,2,inf"] {
            assert!(text.parse::<Tool>().unwrap_err().contains("0,0,-20,0,0,90"), "{text}");
        }
    }
}
