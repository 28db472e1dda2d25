//! The state machine of commands: hello, homing, moves, soft limits, settling.

use rigel_protocol::{
    Answer, Command, Fault, Hello, Limits, Reply, Request, Restart, SCHEMA, State, Status, VERSION,
};

use crate::Motion;

/// The largest angle that a limit may allow, either way: two turns.
const LARGEST_MDEG: i32 = 720_000;
/// The largest speed, a thousand degrees per second, and the largest acceleration, five times that per second: the
/// bounds within which the integers of [`Motion`] do not overflow.
const LARGEST_SPEED_MDEG_S: u32 = 1_000_000;
const LARGEST_ACCELERATION_MDEG_S2: u32 = 5_000_000;

/// The rig's mind: hears requests, knows the position, tells what has ended.
///
/// Times are microseconds of a clock that never turns back.
pub struct Controller {
    board: &'static str,
    limits: Limits,
    greeted: bool,
    homed: bool,
    at_udeg: [i64; 2],
    course: Option<Course>,
    /// The last request that moved something, and what was replied: said again, it is only answered again.
    last: Option<(Request, Reply)>,
}

/// A move that has not been reported as ended.
struct Course {
    motion: Motion,
    start_us: u64,
    sequence: u16,
    stopping: bool,
}

impl Course {
    fn elapsed_us(&self, now_us: u64) -> i64 {
        i64::try_from(now_us.saturating_sub(self.start_us)).unwrap_or(i64::MAX)
    }
}

impl Controller {
    /// A rig that was just switched on. `None` when the limits cannot be those of a rig: they must include 0 on both
    /// axes and stay within two turns, with a speed of 1 to 1 000 000 mdeg/s and an acceleration of 1 to 5 000 000
    /// mdeg/s²; a board's name has at most 24 bytes.
    pub fn new(board: &'static str, limits: Limits) -> Option<Self> {
        let range =
            |min: i32, max: i32| (-LARGEST_MDEG..=0).contains(&min) && (0..=LARGEST_MDEG).contains(&max);
        let good = range(limits.pan_min_mdeg, limits.pan_max_mdeg)
            && range(limits.tilt_min_mdeg, limits.tilt_max_mdeg)
            && (1..=LARGEST_SPEED_MDEG_S).contains(&limits.speed_mdeg_s)
            && (1..=LARGEST_ACCELERATION_MDEG_S2).contains(&limits.acceleration_mdeg_s2)
            && board.len() <= 24;
        good.then_some(Self {
            board,
            limits,
            greeted: false,
            homed: false,
            at_udeg: [0; 2],
            course: None,
            last: None,
        })
    }

    /// Obeys or refuses a request.
    pub fn handle(&mut self, request: Request, now_us: u64) -> Answer {
        let reply = match request.command {
            Command::Hello { version, schema, .. } => {
                self.greeted = version == VERSION && schema == SCHEMA;
                // A new conversation counts from the start again: its first move is no repetition of an old one.
                self.last = None;
                self.hello()
            }
            _ if !self.greeted => Reply::Refused(Fault::NoHello),
            Command::Ping => Reply::Pong { at_us: now_us },
            Command::Status => self.status(now_us),
            _ => match &self.last {
                Some((last, reply)) if *last == request => reply.clone(),
                _ => {
                    let reply = self.obey(&request, now_us).unwrap_or_else(Reply::Refused);
                    self.last = Some((request.clone(), reply.clone()));
                    reply
                }
            },
        };
        Answer { sequence: request.sequence, reply }
    }

    /// Tells, once, that a move has ended and the rig has settled.
    pub fn tick(&mut self, now_us: u64) -> Option<Answer> {
        let course = self.course.as_ref()?;
        if course.elapsed_us(now_us) < course.motion.duration_us() + self.settle_us() {
            return None;
        }
        self.at_udeg = course.motion.position_udeg(course.motion.duration_us());
        let (sequence, stopping) = (course.sequence, course.stopping);
        self.course = None;
        let [pan_mdeg, tilt_mdeg] = self.at_udeg.map(to_mdeg);
        let reply = if stopping {
            Reply::Stopped { pan_mdeg, tilt_mdeg }
        } else {
            Reply::Arrived { pan_mdeg, tilt_mdeg }
        };
        Some(Answer { sequence, reply })
    }

    /// Where the axes (pan, tilt) are to be, microdegrees.
    pub fn position_udeg(&self, now_us: u64) -> [i64; 2] {
        match &self.course {
            Some(course) => course.motion.position_udeg(course.elapsed_us(now_us)),
            None => self.at_udeg,
        }
    }

    /// What the rig is doing.
    pub fn state(&self, now_us: u64) -> State {
        match &self.course {
            Some(course) if course.elapsed_us(now_us) < course.motion.duration_us() => State::Moving,
            Some(_) => State::Settling,
            None if self.homed => State::Still,
            None => State::Lost,
        }
    }

    fn obey(&mut self, request: &Request, now_us: u64) -> Result<Reply, Fault> {
        match request.command {
            Command::Stop => return Ok(self.stop(now_us)),
            _ if self.course.is_some() => return Err(Fault::Busy),
            Command::MoveTo { pan_mdeg, tilt_mdeg } => {
                if !self.homed {
                    return Err(Fault::NotHomed);
                }
                self.within_limits(pan_mdeg, tilt_mdeg)?;
                self.start([pan_mdeg, tilt_mdeg], request.sequence, now_us);
            }
            // Without switches, the place where the rig stands when it is first homed is its zero.
            Command::Home => {
                self.homed = true;
                self.start([0, 0], request.sequence, now_us);
            }
            _ => return Err(Fault::Senseless),
        }
        Ok(self.accepted())
    }

    /// A position beyond a limit is an error: a rig that went elsewhere instead would spoil the photograph silently.
    fn within_limits(&self, pan_mdeg: i32, tilt_mdeg: i32) -> Result<(), Fault> {
        let Limits { pan_min_mdeg, pan_max_mdeg, tilt_min_mdeg, tilt_max_mdeg, .. } = self.limits;
        if !(pan_min_mdeg..=pan_max_mdeg).contains(&pan_mdeg) {
            let (min_mdeg, max_mdeg) = (pan_min_mdeg, pan_max_mdeg);
            return Err(Fault::PanOutside { asked_mdeg: pan_mdeg, min_mdeg, max_mdeg });
        }
        if !(tilt_min_mdeg..=tilt_max_mdeg).contains(&tilt_mdeg) {
            let (min_mdeg, max_mdeg) = (tilt_min_mdeg, tilt_max_mdeg);
            return Err(Fault::TiltOutside { asked_mdeg: tilt_mdeg, min_mdeg, max_mdeg });
        }
        Ok(())
    }

    fn start(&mut self, to_mdeg: [i32; 2], sequence: u16, now_us: u64) {
        let to_udeg = to_mdeg.map(|mdeg| i64::from(mdeg) * 1_000);
        let speed = i64::from(self.limits.speed_mdeg_s) * 1_000;
        let motion = Motion::new(self.at_udeg, to_udeg, speed, self.acceleration());
        self.course = Some(Course { motion, start_us: now_us, sequence, stopping: false });
    }

    fn stop(&mut self, now_us: u64) -> Reply {
        let acceleration = self.acceleration();
        match &mut self.course {
            // A rig that already brakes goes on braking, and one that stands is only left to settle.
            Some(course) if !course.stopping => {
                let elapsed_us = course.elapsed_us(now_us);
                if elapsed_us < course.motion.duration_us() {
                    course.motion = course.motion.brake(elapsed_us, acceleration);
                    course.start_us = now_us;
                    course.stopping = true;
                }
                self.accepted()
            }
            Some(_) => self.accepted(),
            None => Reply::Accepted { duration_ms: 0 },
        }
    }

    fn accepted(&self) -> Reply {
        let motion_us = self.course.as_ref().map_or(0, |course| course.motion.duration_us());
        let duration_ms = u32::try_from((motion_us + self.settle_us()) / 1_000 + 1).unwrap_or(u32::MAX);
        Reply::Accepted { duration_ms }
    }

    fn hello(&self) -> Reply {
        let mut hello = Hello {
            version: VERSION,
            schema: SCHEMA,
            board: Default::default(),
            limits: self.limits,
            restart: Restart::Power,
        };
        // `new` has checked the length, so this cannot fail.
        let _ = hello.board.push_str(self.board);
        Reply::Hello(hello)
    }

    fn status(&self, now_us: u64) -> Reply {
        let [pan_mdeg, tilt_mdeg] = self.position_udeg(now_us).map(to_mdeg);
        Reply::Status(Status {
            state: self.state(now_us),
            pan_mdeg,
            tilt_mdeg,
            halt: None,
            lost_steps: [0; 2],
            exposed: 0,
            confirmed: 0,
            bad_frames: 0,
        })
    }

    fn acceleration(&self) -> i64 {
        i64::from(self.limits.acceleration_mdeg_s2) * 1_000
    }

    fn settle_us(&self) -> i64 {
        i64::from(self.limits.settle_ms) * 1_000
    }
}

/// The nearest thousandth of a degree; positions stay within two turns, far inside an `i32`.
fn to_mdeg(udeg: i64) -> i32 {
    ((udeg + 500).div_euclid(1_000)) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        pan_min_mdeg: -180_000,
        pan_max_mdeg: 180_000,
        winding_mdeg: 180_000,
        tilt_min_mdeg: -10_000,
        tilt_max_mdeg: 90_000,
        speed_mdeg_s: 60_000,
        acceleration_mdeg_s2: 120_000,
        settle_ms: 300,
    };

    /// A rig and a host that talks to it, on a clock that runs when told.
    struct Bench {
        rig: Controller,
        sequence: u16,
        now_us: u64,
    }

    impl Bench {
        fn new() -> Self {
            Self { rig: Controller::new("bench", LIMITS).unwrap(), sequence: 0, now_us: 5_000 }
        }

        fn homed() -> Self {
            let mut bench = Self::new();
            bench.ask(Command::Hello { version: VERSION, schema: SCHEMA, conversation: 1 });
            bench.ask(Command::Home);
            assert_eq!(bench.event().reply, Reply::Arrived { pan_mdeg: 0, tilt_mdeg: 0 });
            bench
        }

        fn ask(&mut self, command: Command) -> Reply {
            self.sequence += 1;
            self.say_again(command)
        }

        fn say_again(&mut self, command: Command) -> Reply {
            let request = Request { sequence: self.sequence, command };
            let answer = self.rig.handle(request, self.now_us);
            assert_eq!(answer.sequence, self.sequence);
            answer.reply
        }

        fn wait_ms(&mut self, ms: u64) {
            self.now_us += ms * 1_000;
        }

        fn event(&mut self) -> Answer {
            for _ in 0..100_000 {
                self.wait_ms(1);
                if let Some(answer) = self.rig.tick(self.now_us) {
                    return answer;
                }
            }
            panic!("no event within 100 s");
        }
    }

    fn move_to(pan_mdeg: i32, tilt_mdeg: i32) -> Command {
        Command::MoveTo { pan_mdeg, tilt_mdeg }
    }

    #[test]
    fn nothing_is_obeyed_before_a_matching_hello() {
        let mut bench = Bench::new();
        assert_eq!(bench.ask(Command::Home), Reply::Refused(Fault::NoHello));
        for (version, schema) in [(VERSION + 1, SCHEMA), (VERSION, !SCHEMA)] {
            let Reply::Hello(hello) = bench.ask(Command::Hello { version, schema }) else { panic!() };
            assert_eq!((hello.version, hello.schema), (VERSION, SCHEMA), "the rig names its own");
            assert_eq!(bench.ask(Command::Home), Reply::Refused(Fault::NoHello));
        }
        let Reply::Hello(hello) =
            bench.ask(Command::Hello { version: VERSION, schema: SCHEMA, conversation: 1 })
        else {
            panic!()
        };
        assert_eq!((hello.board.as_str(), hello.limits), ("bench", LIMITS));
        assert!(matches!(bench.ask(Command::Home), Reply::Accepted { .. }));
    }

    #[test]
    fn a_lost_rig_refuses_to_move() {
        let mut bench = Bench::new();
        bench.ask(Command::Hello { version: VERSION, schema: SCHEMA, conversation: 1 });
        assert_eq!(bench.ask(move_to(1, 1)), Reply::Refused(Fault::NotHomed));
        assert_eq!(bench.rig.state(bench.now_us), State::Lost);
    }

    #[test]
    fn a_move_arrives_when_it_was_promised_and_not_before_it_has_settled() {
        let mut bench = Bench::homed();
        let start_us = bench.now_us;
        let Reply::Accepted { duration_ms } = bench.ask(move_to(90_000, 45_000)) else { panic!() };
        assert_eq!(bench.rig.state(bench.now_us), State::Moving);
        bench.wait_ms(2_001);
        assert_eq!(bench.rig.state(bench.now_us), State::Settling);
        assert_eq!(bench.rig.position_udeg(bench.now_us), [90_000_000, 45_000_000]);
        assert_eq!(bench.rig.tick(bench.now_us), None);
        let answer = bench.event();
        assert_eq!(answer.sequence, bench.sequence);
        assert_eq!(answer.reply, Reply::Arrived { pan_mdeg: 90_000, tilt_mdeg: 45_000 });
        let took_ms = (bench.now_us - start_us) / 1_000;
        assert!(took_ms.abs_diff(duration_ms.into()) <= 2, "{took_ms} {duration_ms}");
        assert!(took_ms.abs_diff(2_300) <= 2);
        assert_eq!(bench.rig.tick(bench.now_us + 1_000_000), None, "told once");
        assert_eq!(bench.rig.state(bench.now_us), State::Still);
    }

    #[test]
    fn limits_are_errors_with_the_value_and_nothing_moves() {
        let mut bench = Bench::homed();
        let (min_mdeg, max_mdeg) = (-180_000, 180_000);
        for asked_mdeg in [180_001, -180_001, i32::MAX, i32::MIN] {
            let fault = Fault::PanOutside { asked_mdeg, min_mdeg, max_mdeg };
            assert_eq!(bench.ask(move_to(asked_mdeg, 0)), Reply::Refused(fault));
        }
        let fault = Fault::TiltOutside { asked_mdeg: -10_001, min_mdeg: -10_000, max_mdeg: 90_000 };
        assert_eq!(bench.ask(move_to(0, -10_001)), Reply::Refused(fault));
        assert_eq!(bench.rig.state(bench.now_us), State::Still);
        assert!(
            matches!(bench.ask(move_to(-180_000, 90_000)), Reply::Accepted { .. }),
            "the limit itself is allowed"
        );
    }

    #[test]
    fn a_repeated_request_is_executed_once_and_answered_again() {
        let mut bench = Bench::homed();
        let first = bench.ask(move_to(30_000, 0));
        bench.wait_ms(200);
        assert_eq!(bench.say_again(move_to(30_000, 0)), first, "not busy: the same request");
        assert_eq!(bench.ask(move_to(40_000, 0)), Reply::Refused(Fault::Busy), "another request");
        bench.event();
        bench.sequence -= 1;
        bench.ask(Command::Status);
        let again = bench.say_again(move_to(40_000, 0));
        assert_eq!(again, Reply::Refused(Fault::Busy), "answered as the first time, even now");
        // A new conversation may use the same number for the same words: that is a new request.
        bench.ask(Command::Hello { version: VERSION, schema: SCHEMA, conversation: 1 });
        assert!(matches!(bench.say_again(move_to(40_000, 0)), Reply::Accepted { .. }));
    }

    #[test]
    fn stop_brakes_on_the_way_and_keeps_the_position() {
        let mut bench = Bench::homed();
        bench.ask(move_to(90_000, 45_000));
        let moving = bench.sequence;
        bench.wait_ms(1_000);
        let [before, _] = bench.rig.position_udeg(bench.now_us);
        let Reply::Accepted { duration_ms } = bench.ask(Command::Stop) else { panic!() };
        assert!(duration_ms.abs_diff(500 + 300) <= 2, "{duration_ms}");
        assert_eq!(bench.rig.position_udeg(bench.now_us), [before, before / 2]);
        let answer = bench.event();
        assert_eq!(answer.sequence, moving);
        let Reply::Stopped { pan_mdeg, tilt_mdeg } = answer.reply else { panic!("{answer:?}") };
        assert!((pan_mdeg - 60_000).abs() <= 2 && (tilt_mdeg - 30_000).abs() <= 2, "{pan_mdeg} {tilt_mdeg}");
        assert_eq!(bench.ask(Command::Stop), Reply::Accepted { duration_ms: 0 });
        let status = Reply::Status { state: State::Still, pan_mdeg, tilt_mdeg };
        assert_eq!(bench.ask(Command::Status), status);
        bench.ask(Command::Home);
        assert_eq!(bench.event().reply, Reply::Arrived { pan_mdeg: 0, tilt_mdeg: 0 });
    }

    #[test]
    fn limits_that_no_rig_can_have_are_refused() {
        let bad = [
            Limits { speed_mdeg_s: 0, ..LIMITS },
            Limits { acceleration_mdeg_s2: 0, ..LIMITS },
            Limits { pan_min_mdeg: 1, ..LIMITS },
            Limits { tilt_max_mdeg: LARGEST_MDEG + 1, ..LIMITS },
            Limits { speed_mdeg_s: u32::MAX, ..LIMITS },
        ];
        assert!(bad.into_iter().all(|limits| Controller::new("bad", limits).is_none()));
        assert!(Controller::new("a name that is too long for it", LIMITS).is_none());
    }

    #[test]
    fn the_widest_and_slowest_rig_does_not_overflow() {
        for (speed_mdeg_s, acceleration_mdeg_s2) in
            [(1, 1), (1_000_000, 1), (1, 5_000_000), (1_000_000, 5_000_000)]
        {
            let (pan_min_mdeg, pan_max_mdeg) = (-LARGEST_MDEG, LARGEST_MDEG);
            let limits = Limits { pan_min_mdeg, pan_max_mdeg, speed_mdeg_s, acceleration_mdeg_s2, ..LIMITS };
            let mut rig = Controller::new("wide", limits).unwrap();
            let mut now_us = 0;
            let commands = [
                Command::Hello { version: VERSION, schema: SCHEMA, conversation: 1 },
                Command::Home,
                move_to(-LARGEST_MDEG, 0),
                move_to(LARGEST_MDEG, 90_000),
            ];
            for (sequence, command) in (0..).zip(commands) {
                rig.handle(Request { sequence, command }, now_us);
                now_us += 1 << 41;
                rig.tick(now_us);
            }
            assert_eq!(rig.position_udeg(now_us), [i64::from(LARGEST_MDEG) * 1_000, 90_000_000]);
        }
    }
}
