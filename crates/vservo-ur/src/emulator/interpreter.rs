//! Runs a program's tree on the emulated controller: instructions take their cycles, registers are those of RTDE.

use super::core::{COULOMB_SHARE, Torque, VISCOUS_SHARE};
use super::motion::Motion;
use super::programs::{End, Host};
use super::syntax::{Action, Block, Expression, Function, Program};
use crate::Joints;
use crate::program::{Payload, TorqueInterface};
use std::collections::HashMap;

/// Rounds of a loop within one cycle before the controller takes it for endless. Chosen by hand: thousand times what a program of registers has.
const ENDLESS: u32 = 10_000;
/// Calls within calls. Chosen by hand: no program here needs three.
const DEEPEST: usize = 32;
/// Deceleration of `stopj` without one, rad/s2: chosen by hand.
const STOP_RAD_S2: f64 = 2.0;

#[derive(Debug, Clone, PartialEq)]
enum Value {
    Nothing,
    Number(f64),
    Bool(bool),
    Text(String),
    List(Vec<Value>),
}

/// How a block ends.
enum Flow {
    On,
    Break,
    Continue,
    Return(Value),
}

struct Machine<'a, 'b> {
    program: &'a Program,
    host: &'a mut Host<'b>,
    globals: HashMap<String, Value>,
    frames: Vec<HashMap<String, Value>>,
    rounds: u32,
    line: usize,
}

/// Runs a program to its end.
pub(super) fn run(program: &Program, host: &mut Host<'_>) -> Result<(), End> {
    let Some(main) = program.functions.first() else { return Ok(()) };
    let mut machine =
        Machine { program, host, globals: HashMap::new(), frames: Vec::new(), rounds: 0, line: 0 };
    match machine.call(main, Vec::new()) {
        Err(End::Wrong(what)) => Err(End::Wrong(format!("line {}: {what}", machine.line))),
        other => other.map(drop),
    }
}

fn wrong<T>(what: impl Into<String>) -> Result<T, End> {
    Err(End::Wrong(what.into()))
}

impl Machine<'_, '_> {
    fn call(&mut self, function: &Function, arguments: Vec<Value>) -> Result<Value, End> {
        if self.frames.len() >= DEEPEST {
            return wrong("functions call each other without an end");
        }
        if arguments.len() != function.parameters.len() {
            return wrong(format!("`{}` takes {} arguments", function.name, function.parameters.len()));
        }
        self.frames.push(function.parameters.iter().cloned().zip(arguments).collect());
        let flow = self.block(&function.body);
        self.frames.pop();
        match flow? {
            Flow::Return(value) => Ok(value),
            _ => Ok(Value::Nothing),
        }
    }

    fn block(&mut self, block: &Block) -> Result<Flow, End> {
        for (line, action) in block {
            self.line = *line;
            match self.action(action)? {
                Flow::On => {}
                other => return Ok(other),
            }
        }
        Ok(Flow::On)
    }

    fn action(&mut self, action: &Action) -> Result<Flow, End> {
        match action {
            Action::Assign { global, name, value } => {
                let value = self.value(value)?;
                let of_frame = self.frames.last().is_some_and(|frame| frame.contains_key(name));
                if *global || (!of_frame && self.globals.contains_key(name)) {
                    self.globals.insert(name.clone(), value);
                } else if let Some(frame) = self.frames.last_mut() {
                    frame.insert(name.clone(), value);
                }
            }
            Action::AssignItem { name, index, value } => {
                let (index, value) = (self.number(index)?, self.value(value)?);
                let of_frame = self.frames.last_mut().and_then(|frame| frame.get_mut(name));
                let list = of_frame.or(self.globals.get_mut(name));
                let Some(Value::List(items)) = list else { return wrong(format!("`{name}` is no list")) };
                let Some(item) = items.get_mut(index as usize) else {
                    return wrong(format!("`{name}` has no item {index}"));
                };
                *item = value;
            }
            Action::Evaluate(expression) => drop(self.value(expression)?),
            Action::If(branches, otherwise) => {
                for (condition, block) in branches {
                    if self.condition(condition)? {
                        return self.block(block);
                    }
                }
                return self.block(otherwise);
            }
            Action::While(condition, body) => {
                while self.condition(condition)? {
                    self.rounds += 1;
                    if self.rounds > ENDLESS {
                        return wrong("a loop without an end: it takes no cycle");
                    }
                    match self.block(body)? {
                        Flow::Break => break,
                        Flow::Return(value) => return Ok(Flow::Return(value)),
                        Flow::On | Flow::Continue => {}
                    }
                }
            }
            Action::Return(value) => {
                let value = value.as_ref().map_or(Ok(Value::Nothing), |value| self.value(value))?;
                return Ok(Flow::Return(value));
            }
            Action::Break => return Ok(Flow::Break),
            Action::Continue => return Ok(Flow::Continue),
        }
        Ok(Flow::On)
    }

    fn condition(&mut self, expression: &Expression) -> Result<bool, End> {
        match self.value(expression)? {
            Value::Bool(is) => Ok(is),
            other => wrong(format!("{other:?} is neither true nor false")),
        }
    }

    fn number(&mut self, expression: &Expression) -> Result<f64, End> {
        match self.value(expression)? {
            Value::Number(number) => Ok(number),
            other => wrong(format!("{other:?} is no number")),
        }
    }

    fn value(&mut self, expression: &Expression) -> Result<Value, End> {
        Ok(match expression {
            Expression::Number(number) => Value::Number(*number),
            Expression::Bool(is) => Value::Bool(*is),
            Expression::Text(text) => Value::Text(text.clone()),
            Expression::Name(name) => {
                let found = self.frames.last().and_then(|frame| frame.get(name)).or(self.globals.get(name));
                match found {
                    Some(value) => value.clone(),
                    None => return wrong(format!("`{name}` is not known")),
                }
            }
            Expression::List(items) => {
                Value::List(items.iter().map(|item| self.value(item)).collect::<Result<_, _>>()?)
            }
            Expression::Item(list, index) => {
                let (list, index) = (self.value(list)?, self.number(index)?);
                let Value::List(items) = list else { return wrong("only a list has items") };
                match items.get(index as usize) {
                    Some(item) => item.clone(),
                    None => return wrong(format!("a list of {} has no item {index}", items.len())),
                }
            }
            Expression::Unary("-", of) => Value::Number(-self.number(of)?),
            Expression::Unary(_, of) => Value::Bool(!self.condition(of)?),
            Expression::Binary(name @ ("and" | "or" | "xor"), a, b) => {
                let a = self.condition(a)?;
                Value::Bool(match *name {
                    "and" => a && self.condition(b)?,
                    "or" => a || self.condition(b)?,
                    _ => a != self.condition(b)?,
                })
            }
            Expression::Binary(name @ ("==" | "!="), a, b) => {
                let same = self.value(a)? == self.value(b)?;
                Value::Bool(same == (*name == "=="))
            }
            Expression::Binary(name, a, b) => {
                let (a, b) = (self.number(a)?, self.number(b)?);
                match *name {
                    "<" => Value::Bool(a < b),
                    "<=" => Value::Bool(a <= b),
                    ">" => Value::Bool(a > b),
                    ">=" => Value::Bool(a >= b),
                    "+" => Value::Number(a + b),
                    "-" => Value::Number(a - b),
                    "*" => Value::Number(a * b),
                    "/" => Value::Number(a / b),
                    _ => Value::Number(a % b),
                }
            }
            Expression::Call(name, arguments) => return self.named(name, arguments),
        })
    }

    /// Calls a function of the program, or an instruction of the controller.
    fn named(&mut self, name: &str, arguments: &[(Option<String>, Expression)]) -> Result<Value, End> {
        let mut values = Vec::with_capacity(arguments.len());
        for (key, argument) in arguments {
            values.push((key.as_deref(), self.value(argument)?));
        }
        if let Some(function) = self.program.functions.iter().find(|f| f.name == name) {
            return self.call(function, values.into_iter().map(|(_, value)| value).collect());
        }
        let arguments = Arguments(values);
        let period_s = self.host.period_s();
        match name {
            "read_input_integer_register" => {
                let read = self.host.input_int(arguments.index(0)?);
                return read
                    .map_or_else(|| wrong("there is no such register"), |v| Ok(Value::Number(v.into())));
            }
            "read_input_float_register" => {
                let read = self.host.input_double(arguments.index(0)?);
                return read.map_or_else(|| wrong("there is no such register"), |v| Ok(Value::Number(v)));
            }
            "write_output_integer_register" => {
                self.host.put_int(arguments.index(0)?, arguments.number(1, "value", None)? as i32)
            }
            "write_output_float_register" => {
                self.host.put_double(arguments.index(0)?, arguments.number(1, "value", None)?)
            }
            "sqrt" => return Ok(Value::Number(arguments.number(0, "f", None)?.sqrt())),
            "get_steptime" => return Ok(Value::Number(period_s)),
            "get_target_joint_positions" => {
                return Ok(Value::List(self.host.target().map(Value::Number).to_vec()));
            }
            "set_payload" => self.host.carry(Payload {
                mass_kg: arguments.number(0, "m", None)?,
                com_m: arguments.numbers(1, "cog")?,
                inertia_kg_m2: None,
            })?,
            "set_target_payload" => self.host.carry(Payload {
                mass_kg: arguments.number(0, "m", None)?,
                com_m: arguments.numbers(1, "cog")?,
                inertia_kg_m2: Some(arguments.numbers(2, "inertia")?),
            })?,
            "textmsg" => self.host.tell(format!("{:?}", arguments.0)),
            "sync" => {
                self.rounds = 0;
                self.host.sync()?;
            }
            "servoj" => {
                self.rounds = 0;
                let motion = Motion::Servo {
                    q: arguments.joints(0, "q")?,
                    lookahead_s: arguments.number(4, "lookahead_time", Some(0.1))?,
                    gain: arguments.number(5, "gain", Some(300.0))?,
                };
                if let Motion::Servo { lookahead_s, gain, .. } = motion
                    && !((0.03..=0.2).contains(&lookahead_s) && (100.0..=2000.0).contains(&gain))
                {
                    return wrong("servoj takes a lookahead of 0.03 to 0.2 s and a gain of 100 to 2000");
                }
                self.host.go(motion, arguments.number(3, "t", Some(period_s))?)?;
            }
            "speedj" => {
                self.rounds = 0;
                let motion = Motion::Speed {
                    qd: arguments.joints(0, "qd")?,
                    acceleration: arguments.number(1, "a", None)?,
                };
                self.host.go(motion, arguments.number(2, "t", Some(period_s))?)?;
            }
            "direct_torque" => {
                self.rounds = 0;
                let torque = arguments.torque(self.host.torques()?)?;
                self.host.go(Motion::Push(torque), period_s)?;
            }
            "stopj" => {
                self.rounds = 0;
                self.host.stop(arguments.number(0, "a", Some(STOP_RAD_S2))?)?;
            }
            other => return wrong(format!("`{other}` is not emulated")),
        }
        Ok(Value::Nothing)
    }
}

/// The arguments of a call.
struct Arguments<'a>(Vec<(Option<&'a str>, Value)>);

impl Arguments<'_> {
    fn get(&self, at: usize, name: &str) -> Option<&Value> {
        let named = self.0.iter().find(|(key, _)| *key == Some(name));
        named.or(self.0.get(at).filter(|(key, _)| key.is_none())).map(|(_, value)| value)
    }

    fn number(&self, at: usize, name: &str, otherwise: Option<f64>) -> Result<f64, End> {
        match (self.get(at, name), otherwise) {
            (Some(Value::Number(number)), _) => Ok(*number),
            (None, Some(number)) => Ok(number),
            _ => wrong(format!("argument {} (`{name}`) must be a number", at + 1)),
        }
    }

    fn index(&self, at: usize) -> Result<usize, End> {
        let number = self.number(at, "address", None)?;
        // Beyond every register where it is none.
        Ok(if number >= 0.0 && number.fract() == 0.0 { number as usize } else { usize::MAX })
    }

    fn joints(&self, at: usize, name: &str) -> Result<Joints, End> {
        self.numbers(at, name)
    }

    /// What `direct_torque` is told, by the names of this version.
    fn torque(&self, interface: TorqueInterface) -> Result<Torque, End> {
        let known: &[&str] = match interface {
            TorqueInterface::FrictionSwitch => &["torque", "friction_comp"],
            TorqueInterface::FrictionScales => &["torque", "friction_comp", "viscous_scale", "coulomb_scale"],
        };
        if let Some(key) = self.0.iter().filter_map(|(key, _)| *key).find(|key| !known.contains(key)) {
            return wrong(format!("`direct_torque` of this version does not know `{key}`"));
        }
        let mut torque = Torque {
            tau: self.joints(0, "torque")?,
            viscous_share: VISCOUS_SHARE,
            coulomb_share: COULOMB_SHARE,
        };
        if self.get(usize::MAX, "friction_comp") == Some(&Value::Bool(false)) {
            (torque.viscous_share, torque.coulomb_share) = Default::default();
        }
        for (key, share) in
            [("viscous_scale", &mut torque.viscous_share), ("coulomb_scale", &mut torque.coulomb_share)]
        {
            if self.get(usize::MAX, key).is_some() {
                *share = self.joints(usize::MAX, key)?;
            }
        }
        let mut shares = torque.viscous_share.iter().chain(&torque.coulomb_share);
        if !shares.all(|share| (0.0..=1.0).contains(share)) {
            return wrong("shares of the friction are 0 to 1");
        }
        Ok(torque)
    }

    fn numbers<const N: usize>(&self, at: usize, name: &str) -> Result<[f64; N], End> {
        let Some(Value::List(items)) = self.get(at, name) else {
            return wrong(format!("`{name}` must be a list of {N}"));
        };
        let numbers: Vec<f64> =
            items.iter().filter_map(|v| if let Value::Number(n) = v { Some(*n) } else { None }).collect();
        let numbers: Result<[f64; N], _> = numbers.try_into();
        numbers.map_err(|_| End::Wrong(format!("`{name}` must be a list of {N} numbers")))
    }
}
