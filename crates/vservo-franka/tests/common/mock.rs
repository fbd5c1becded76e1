//! The robot that `contrib/crosswise/franka_mock.sh` builds around the maker's mock server, and what it says.

use super::{address, clock, wait_until};
use std::io::{BufRead, BufReader};
use std::net::IpAddr;
use std::process::{Child, Command as Process, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;
use vservo_franka::arm::ArmState;
use vservo_franka::client::FciClient;
use vservo_franka::wire::RobotCommand;
use vservo_franka::{Arm, ArmSettings, Command, FrankaError, Joints};

/// Longest that anything is waited for: a machine may be busy.
pub const PATIENCE: Duration = Duration::from_secs(20);

/// The maker's server, and what it says. Ends with the test.
pub struct Mock {
    process: Child,
    address: IpAddr,
    lines: Receiver<String>,
}

impl Drop for Mock {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// The server with a script; none where it was not built.
pub fn mock(script: &[&str]) -> Option<Mock> {
    let Some(program) = std::env::var_os("VSERVO_FRANKA_MOCK") else {
        println!("skipped: no VSERVO_FRANKA_MOCK (contrib/crosswise/franka_mock.sh builds it)");
        return None;
    };
    let address = address();
    let mut process =
        Process::new(program).arg(address.to_string()).args(script).stdout(Stdio::piped()).spawn().unwrap();
    let output = BufReader::new(process.stdout.take().unwrap());
    let (to, lines) = channel();
    let thread = std::thread::Builder::new().name("mock-output".into());
    drop(
        thread
            .spawn(move || output.lines().map_while(Result::ok).try_for_each(|line| to.send(line)))
            .unwrap(),
    );
    let mock = Mock { process, address, lines };
    assert_eq!(mock.lines.recv_timeout(PATIENCE).unwrap(), "listening");
    Some(mock)
}

impl Mock {
    pub fn settings(&self) -> ArmSettings {
        let mut settings = ArmSettings::new(self.address, clock);
        (settings.patience, settings.silence) = (PATIENCE, PATIENCE);
        settings
    }

    pub fn client(&self) -> FciClient {
        FciClient::connect(self.address, PATIENCE, clock).unwrap()
    }

    /// What it has said, when its client is gone. The server itself looks then whether anything is left that it was sent, and says so.
    pub fn end(mut self) -> Log {
        let mut status = None;
        wait_until("the end of the maker's server", || {
            status = self.process.try_wait().unwrap();
            status.is_some()
        });
        let log = Log(self.lines.iter().collect());
        assert!(status.unwrap().success(), "{:?}", log.others());
        assert_eq!(log.0.last().unwrap(), "the maker's server is content");
        log
    }
}

/// What the server has taken.
pub struct Log(Vec<String>);

impl Log {
    /// Everything but commands.
    pub fn others(&self) -> Vec<&str> {
        self.0.iter().map(String::as_str).filter(|line| !line.starts_with("command ")).collect()
    }

    /// Commands as they came, and whether all that our driver never sets was zero.
    pub fn commands(&self) -> Vec<RobotCommand> {
        let lines = self.0.iter().filter_map(|line| line.strip_prefix("command "));
        let read = |line: &str| {
            let (number, rest) = line.split_once(' ').unwrap();
            let mut words = rest.split(' ');
            let values: Vec<f64> = words.by_ref().take(45).map(number_of).collect();
            let flags: Vec<_> = words.collect();
            let joints = |from: usize| -> Joints { values[from..from + 7].try_into().unwrap() };
            assert!(values[14..38].iter().all(|v| v.to_bits() == 0) && flags[0] == "0", "Cartesian: {line}");
            RobotCommand {
                message_id: number.parse().unwrap(),
                q_c: joints(0),
                dq_c: joints(7),
                motion_finished: flags[1] == "1",
                tau_c: joints(38),
                torque_finished: flags[2] == "1",
            }
        };
        lines.map(read).collect()
    }

    /// The numbers of a request, where there was one of this name.
    pub fn told(&self, name: &str) -> Vec<Vec<f64>> {
        let of = |line: &&str| line.split(' ').next() == Some(name);
        let numbers =
            |line: &str| line.split(' ').skip(1).filter(|word| word.len() == 16).map(number_of).collect();
        self.others().into_iter().filter(of).map(numbers).collect()
    }

    /// A number of the last line.
    pub fn at_the_end(&self, name: &str) -> f64 {
        let line = self.0.iter().find(|line| line.starts_with("over ")).expect("the end of the script");
        let mut words = line.split(' ').skip_while(|word| *word != name).skip(1);
        words.next().unwrap().parse().unwrap()
    }
}

fn number_of(word: &str) -> f64 {
    f64::from_bits(u64::from_str_radix(word, 16).unwrap())
}

/// Answers so many states by commands, by their number.
pub fn drive(
    arm: &mut Arm,
    states: u64,
    command: impl Fn(u64) -> Command,
    mut each: impl FnMut(&ArmState),
) -> Result<(), FrankaError> {
    let (mut count, until) = (0, clock() + 3 * PATIENCE.as_nanos() as i64);
    while count < states {
        if let Some(state) = arm.next(Duration::from_millis(20))? {
            each(&state);
            arm.command(command(count))?;
            count += 1;
        }
        assert!(clock() < until, "no state, and no error");
    }
    Ok(())
}

/// Brakes the arm however long that takes here, and ends the motion.
pub fn rest(arm: &mut Arm) {
    wait_until("rest", || {
        drive(arm, 20, |_| Command::Hold, |_| ()).unwrap();
        arm.last().unwrap().rests()
    });
    arm.come_to_rest().unwrap();
}

/// Turns the first joint, and the fourth the other way.
pub fn swing(count: u64) -> Command {
    let rise = 1.0 - (-(count as f64) / 100.0).exp();
    Command::keep([0.4 * rise, 0.0, 0.0, -0.2 * rise, 0.0, 0.0, 0.0])
}
