//! A positioning drive of the storage: follows a position set-point as fast as its limits allow.

use crate::incident::IncidentKind;
use crate::records::Records;

/// Highest speed, µm in one tick of 1 ms (that is mm/s).
const VELOCITY_MAX: i32 = 1000;
/// Acceleration, µm/ms² (10 m/s²).
const ACCELERATION: i32 = 10;
/// Brakes hold more than the motor pushes, which is also what keeps the last micrometres from swinging.
const BRAKING: i32 = 20;
/// A set-point further away than this trips the drive.
pub(crate) const FOLLOWING_ERROR_MAX_UM: i32 = 80_000;
const IN_POSITION_UM: i32 = 500;

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Drive {
    name: &'static str,
    pub position_um: i32,
    /// µm a tick of 1 ms, that is mm/s.
    pub velocity: i32,
    min_um: i32,
    max_um: i32,
    pub tripped: bool,
}

impl Drive {
    pub fn new(name: &'static str, min_um: i32, max_um: i32) -> Self {
        Drive {
            name,
            position_um: 0,
            velocity: 0,
            min_um,
            max_um,
            tripped: false,
        }
    }

    /// One tick of 1 ms.
    pub fn step(&mut self, enable: bool, setpoint_um: i32, unit: u8, records: &mut Records) {
        if !enable {
            self.tripped = false;
        }
        let follows = enable && !self.tripped;
        let distance_um = setpoint_um - self.position_um;
        let too_far = follows && distance_um.abs() > FOLLOWING_ERROR_MAX_UM;
        let (name, position_um) = (self.name, self.position_um);
        if records.watch((unit, name, 0), too_far, IncidentKind::FollowingError, &[], || {
            format!(
                "axis {name} stands at {} mm and cannot follow its set-point {} mm: a distance above {} mm asks for more acceleration than the drive has",
                millimetres(position_um),
                millimetres(setpoint_um),
                millimetres(FOLLOWING_ERROR_MAX_UM)
            )
        }) {
            self.tripped = true;
        }
        if follows && !self.tripped {
            self.chase(distance_um);
        } else {
            self.velocity -= self.velocity.clamp(-BRAKING, BRAKING);
        }
        self.position_um += self.velocity;
        let pressed = !(self.min_um..=self.max_um).contains(&self.position_um)
            || (follows && self.position_um == self.min_um && setpoint_um < self.min_um)
            || (follows && self.position_um == self.max_um && setpoint_um > self.max_um);
        if pressed {
            self.position_um = self.position_um.clamp(self.min_um, self.max_um);
            self.velocity = 0;
        }
        let at_um = self.position_um;
        if records.watch(
            (unit, name, 1),
            pressed,
            IncidentKind::DrivenAgainstStop,
            &[],
            || {
                format!(
                    "axis {name} is driven against its mechanical stop at {} mm",
                    millimetres(at_um)
                )
            },
        ) {
            self.tripped = true;
        }
    }

    pub fn is_in_position(&self, enable: bool, setpoint_um: i32) -> bool {
        enable
            && !self.tripped
            && self.velocity == 0
            && (setpoint_um - self.position_um).abs() <= IN_POSITION_UM
    }

    /// Speed that still lets the axis stop at the set-point, reached within the acceleration.
    fn chase(&mut self, distance_um: i32) {
        let stopping = (2 * ACCELERATION as u32 * distance_um.unsigned_abs()).isqrt() as i32;
        let wanted = distance_um.signum() * stopping.min(VELOCITY_MAX).min(distance_um.abs());
        let slows = wanted.signum() != self.velocity.signum() || wanted.abs() < self.velocity.abs();
        let limit = if slows { BRAKING } else { ACCELERATION };
        self.velocity += (wanted - self.velocity).clamp(-limit, limit);
    }
}

fn millimetres(um: i32) -> String {
    let sign = if um < 0 { "-" } else { "" };
    format!(
        "{sign}{}.{}",
        um.unsigned_abs() / 1000,
        um.unsigned_abs() / 100 % 10
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reaches_every_setpoint_within_the_following_error_and_never_overshoots() {
        for setpoint_um in (-80_000..=80_000).step_by(1_237) {
            let mut records = Records::new(0);
            let mut drive = Drive::new("X", -100_000, 100_000);
            for _ in 0..400 {
                drive.step(true, setpoint_um, 4, &mut records);
                assert!(
                    drive.position_um.abs() <= setpoint_um.abs(),
                    "overshoot on the way to {setpoint_um}"
                );
            }
            assert_eq!((drive.position_um, drive.velocity), (setpoint_um, 0));
            assert_eq!(records.incidents, []);
        }
    }

    #[test]
    fn lags_as_documented_behind_a_steady_setpoint() {
        let mut records = Records::new(0);
        let mut drive = Drive::new("X", -20_000, 480_000);
        let mut setpoint_um = 0;
        let mut speed = 0;
        for tick in 0..600 {
            speed = (speed + 3).min(600);
            if tick % 5 == 0 {
                setpoint_um += speed * 5;
            }
            drive.step(true, setpoint_um.min(470_000), 4, &mut records);
            if tick == 580 {
                let lag_um = setpoint_um - drive.position_um;
                assert!((14_000..=24_000).contains(&lag_um), "lag {lag_um} um");
            }
        }
        assert_eq!(records.incidents, []);
    }
}
