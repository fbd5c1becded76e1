//! URScript, as much as is needed here: from text to a tree. What is not known is refused with its line, as a controller does.
//!
//! ```text
//! def name(a, b): ... end      while c: ... end      if c: ... elif d: ... else: ... end      return x   break   continue
//! [local | global] x = expression      x[i] = expression      call(a, name=b)      # comment
//! or, and, not, == != < <= > >=, + -, * / %, -x, x[i], [a, b], "text", True, False
//! ```

use std::fmt;

/// A text that is no program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct SyntaxError {
    line: usize,
    what: String,
}

impl fmt::Display for SyntaxError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.what)
    }
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Expression {
    Number(f64),
    Bool(bool),
    Text(String),
    Name(String),
    List(Vec<Expression>),
    Call(String, Vec<(Option<String>, Expression)>),
    Item(Box<Expression>, Box<Expression>),
    Unary(&'static str, Box<Expression>),
    Binary(&'static str, Box<Expression>, Box<Expression>),
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Action {
    Assign { global: bool, name: String, value: Expression },
    AssignItem { name: String, index: Expression, value: Expression },
    Evaluate(Expression),
    If(Vec<(Expression, Block)>, Block),
    While(Expression, Block),
    Return(Option<Expression>),
    Break,
    Continue,
}

/// An action with its line.
pub(super) type Statement = (usize, Action);
pub(super) type Block = Vec<Statement>;

/// A function.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Function {
    pub(super) name: String,
    pub(super) parameters: Vec<String>,
    pub(super) body: Block,
}

/// A program: its first function is what runs, which may hold others.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Program {
    pub(super) functions: Vec<Function>,
}

/// Signs, longer ones first.
const SIGNS: [&str; 20] =
    ["==", "!=", "<=", ">=", "<", ">", "=", "+", "-", "*", "/", "%", "(", ")", "[", "]", ",", ":", ".", "^"];

#[derive(Debug, Clone, PartialEq)]
enum Token {
    Number(f64),
    Word(String),
    Text(String),
    Sign(&'static str),
}

/// The tokens of a line, without its comment.
fn tokens(line: &str) -> Result<Vec<Token>, String> {
    let mut found = Vec::new();
    let mut rest = line.trim_start();
    while let Some(first) = rest.chars().next() {
        let taken = if first == '#' {
            break;
        } else if first.is_ascii_digit() {
            let mut end = rest.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(rest.len());
            let exponent = rest.get(end..).filter(|tail| tail.starts_with(['e', 'E']));
            if let Some(tail) = exponent {
                let digits = tail
                    .char_indices()
                    .skip(1)
                    .find(|(i, c)| !(c.is_ascii_digit() || *i == 1 && "+-".contains(*c)));
                end += digits.map_or(tail.len(), |(i, _)| i);
            }
            let text = rest.get(..end).unwrap_or_default();
            found.push(Token::Number(text.parse().map_err(|_| format!("`{text}` is no number"))?));
            end
        } else if first.is_alphabetic() || first == '_' {
            let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
            found.push(Token::Word(rest.get(..end).unwrap_or_default().to_owned()));
            end
        } else if first == '"' {
            let end = rest.get(1..).and_then(|tail| tail.find('"')).ok_or("a text without its end")?;
            found.push(Token::Text(rest.get(1..=end).unwrap_or_default().to_owned()));
            end + 2
        } else {
            let sign = SIGNS.iter().find(|sign| rest.starts_with(**sign));
            let sign = sign.ok_or_else(|| format!("`{first}` is not known"))?;
            found.push(Token::Sign(sign));
            sign.len()
        };
        rest = rest.get(taken..).unwrap_or_default().trim_start();
    }
    Ok(found)
}

/// A program of a text.
pub(super) fn parse(text: &str) -> Result<Program, SyntaxError> {
    let mut lines = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let tokens = tokens(line).map_err(|what| SyntaxError { line: i + 1, what })?;
        if !tokens.is_empty() {
            lines.push((i + 1, tokens));
        }
    }
    let mut parser = Parser { lines, at: 0, functions: Vec::new() };
    while parser.at < parser.lines.len() {
        if !parser.begins("def") {
            return Err(parser.error("a program is a function: `def name():`"));
        }
        parser.function()?;
    }
    if parser.functions.is_empty() {
        return Err(SyntaxError { line: 1, what: "there is no program".into() });
    }
    // The outer function ends last, and is what runs.
    parser.functions.reverse();
    Ok(Program { functions: parser.functions })
}

struct Parser {
    lines: Vec<(usize, Vec<Token>)>,
    at: usize,
    functions: Vec<Function>,
}

impl Parser {
    fn error(&self, what: &str) -> SyntaxError {
        let line = self.lines.get(self.at).or(self.lines.last()).map_or(0, |(line, _)| *line);
        SyntaxError { line, what: what.into() }
    }

    fn begins(&self, word: &str) -> bool {
        self.lines.get(self.at).is_some_and(|(_, tokens)| tokens.first() == Some(&Token::Word(word.into())))
    }

    /// The rest of a line behind its keyword, of which the colon at the end is taken away.
    fn head(&mut self) -> Result<(usize, Vec<Token>), SyntaxError> {
        let Some((line, mut tokens)) = self.lines.get(self.at).cloned() else {
            return Err(self.error("`end` is missing"));
        };
        if tokens.pop() != Some(Token::Sign(":")) {
            return Err(self.error("`:` is missing"));
        }
        tokens.remove(0);
        self.at += 1;
        Ok((line, tokens))
    }

    fn whole(&self, line: usize, tokens: Vec<Token>) -> Result<Expression, SyntaxError> {
        let mut reader = Tokens { tokens: &tokens };
        let value = reader.expression(0).map_err(|what| SyntaxError { line, what })?;
        match reader.tokens.first() {
            None => Ok(value),
            Some(more) => Err(SyntaxError { line, what: format!("{more:?} is one too many") }),
        }
    }

    fn function(&mut self) -> Result<(), SyntaxError> {
        let (line, tokens) = self.head()?;
        let call = self.whole(line, tokens)?;
        let Expression::Call(name, arguments) = call else {
            return Err(SyntaxError { line, what: "`def name():` is expected".into() });
        };
        let parameters = arguments.into_iter().filter_map(|(_, a)| match a {
            Expression::Name(name) => Some(name),
            _ => None,
        });
        let parameters = parameters.collect();
        let body = self.block()?;
        self.end()?;
        self.functions.push(Function { name, parameters, body });
        Ok(())
    }

    fn end(&mut self) -> Result<(), SyntaxError> {
        if !self.begins("end") {
            return Err(self.error("`end` is missing"));
        }
        self.at += 1;
        Ok(())
    }

    fn block(&mut self) -> Result<Block, SyntaxError> {
        let mut block = Vec::new();
        while self.at < self.lines.len() && !["end", "elif", "else"].iter().any(|word| self.begins(word)) {
            if self.begins("def") {
                self.function()?;
            } else {
                block.push(self.statement()?);
            }
        }
        Ok(block)
    }

    fn statement(&mut self) -> Result<Statement, SyntaxError> {
        if self.begins("while") {
            let (line, tokens) = self.head()?;
            let condition = self.whole(line, tokens)?;
            let body = self.block()?;
            self.end()?;
            return Ok((line, Action::While(condition, body)));
        }
        if self.begins("if") {
            let (line, tokens) = self.head()?;
            let mut branches = vec![(self.whole(line, tokens)?, self.block()?)];
            while self.begins("elif") {
                let (line, tokens) = self.head()?;
                branches.push((self.whole(line, tokens)?, self.block()?));
            }
            let mut otherwise = Vec::new();
            if self.begins("else") {
                self.head()?;
                otherwise = self.block()?;
            }
            self.end()?;
            return Ok((line, Action::If(branches, otherwise)));
        }
        let Some((line, tokens)) = self.lines.get(self.at).cloned() else {
            return Err(self.error("a statement is missing"));
        };
        self.at += 1;
        let wrong = |what: String| SyntaxError { line, what };
        let action = match tokens.as_slice() {
            [Token::Word(word), rest @ ..] if word == "return" => {
                let value = if rest.is_empty() { None } else { Some(self.whole(line, rest.to_vec())?) };
                Action::Return(value)
            }
            [Token::Word(word)] if word == "break" => Action::Break,
            [Token::Word(word)] if word == "continue" => Action::Continue,
            [Token::Word(word), ..] if ["thread", "run", "kill", "join"].contains(&word.as_str()) => {
                return Err(wrong(format!("`{word}` is not emulated")));
            }
            [Token::Word(scope), Token::Word(name), Token::Sign("="), value @ ..]
                if scope == "local" || scope == "global" =>
            {
                Action::Assign {
                    global: scope == "global",
                    name: name.clone(),
                    value: self.whole(line, value.to_vec())?,
                }
            }
            [Token::Word(name), Token::Sign("="), value @ ..] => {
                Action::Assign { global: false, name: name.clone(), value: self.whole(line, value.to_vec())? }
            }
            [Token::Word(name), Token::Sign("["), rest @ ..] if rest.contains(&Token::Sign("=")) => {
                let equals = rest.iter().position(|t| *t == Token::Sign("=")).unwrap_or(0);
                let (index, value) = rest.split_at(equals);
                let Some((Token::Sign("]"), index)) = index.split_last() else {
                    return Err(wrong("`]` is missing".into()));
                };
                let index = self.whole(line, index.to_vec())?;
                let value = self.whole(line, value.get(1..).unwrap_or_default().to_vec())?;
                Action::AssignItem { name: name.clone(), index, value }
            }
            _ => Action::Evaluate(self.whole(line, tokens)?),
        };
        Ok((line, action))
    }
}

/// Binary operators by what binds more.
const LEVELS: [&[&str]; 5] =
    [&["or", "xor"], &["and"], &["==", "!=", "<=", ">=", "<", ">"], &["+", "-"], &["*", "/", "%"]];

struct Tokens<'a> {
    tokens: &'a [Token],
}

impl Tokens<'_> {
    fn take(&mut self, sign: &str) -> bool {
        let is = matches!(self.tokens.first(), Some(Token::Sign(s)) if *s == sign);
        if is {
            self.tokens = self.tokens.get(1..).unwrap_or_default();
        }
        is
    }

    fn operator(&mut self, level: usize) -> Option<&'static str> {
        let names = LEVELS.get(level)?;
        let found = match self.tokens.first()? {
            Token::Sign(sign) => names.iter().find(|name| *name == sign),
            Token::Word(word) => names.iter().find(|name| *name == word),
            _ => None,
        }?;
        self.tokens = self.tokens.get(1..).unwrap_or_default();
        Some(found)
    }

    fn expression(&mut self, level: usize) -> Result<Expression, String> {
        if level == LEVELS.len() {
            return self.unary();
        }
        let mut left = self.expression(level + 1)?;
        while let Some(name) = self.operator(level) {
            left = Expression::Binary(name, Box::new(left), Box::new(self.expression(level + 1)?));
        }
        Ok(left)
    }

    fn unary(&mut self) -> Result<Expression, String> {
        if self.take("-") {
            return Ok(Expression::Unary("-", Box::new(self.unary()?)));
        }
        if matches!(self.tokens.first(), Some(Token::Word(word)) if word == "not") {
            self.tokens = self.tokens.get(1..).unwrap_or_default();
            return Ok(Expression::Unary("not", Box::new(self.expression(2)?)));
        }
        let mut value = self.primary()?;
        while self.take("[") {
            let index = self.expression(0)?;
            if !self.take("]") {
                return Err("`]` is missing".into());
            }
            value = Expression::Item(Box::new(value), Box::new(index));
        }
        Ok(value)
    }

    fn primary(&mut self) -> Result<Expression, String> {
        let Some((first, rest)) = self.tokens.split_first() else { return Err("a value is missing".into()) };
        self.tokens = rest;
        match first {
            Token::Number(number) => Ok(Expression::Number(*number)),
            Token::Text(text) => Ok(Expression::Text(text.clone())),
            Token::Sign("(") => {
                let inner = self.expression(0)?;
                if self.take(")") { Ok(inner) } else { Err("`)` is missing".into()) }
            }
            Token::Sign("[") => {
                Ok(Expression::List(self.list("]")?.into_iter().map(|(_, value)| value).collect()))
            }
            Token::Word(word) => match word.as_str() {
                "True" | "true" => Ok(Expression::Bool(true)),
                "False" | "false" => Ok(Expression::Bool(false)),
                // A pose is a list here: nothing that is emulated makes a difference.
                "p" if self.take("[") => {
                    Ok(Expression::List(self.list("]")?.into_iter().map(|(_, value)| value).collect()))
                }
                name if self.take("(") => Ok(Expression::Call(name.to_owned(), self.list(")")?)),
                name => Ok(Expression::Name(name.to_owned())),
            },
            Token::Sign(sign) => Err(format!("`{sign}` is not expected")),
        }
    }

    fn list(&mut self, end: &str) -> Result<Vec<(Option<String>, Expression)>, String> {
        let mut items = Vec::new();
        while !self.take(end) {
            let name = match self.tokens {
                [Token::Word(name), Token::Sign("="), rest @ ..] => {
                    self.tokens = rest;
                    Some(name.clone())
                }
                _ => None,
            };
            items.push((name, self.expression(0)?));
            if !self.take(",") && !matches!(self.tokens.first(), Some(Token::Sign(s)) if *s == end) {
                return Err(format!("`{end}` is missing"));
            }
        }
        Ok(items)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_binds_more_is_done_first() {
        let program = parse("def f():\n  x = 1 + 2 * -y[3] >= 4 and not b or c\nend\n").unwrap();
        let [(2, Action::Assign { value, .. })] = program.functions[0].body.as_slice() else { panic!() };
        let Expression::Binary("or", left, _) = value else { panic!("{value:?}") };
        let Expression::Binary("and", comparison, not_b) = &**left else { panic!("{left:?}") };
        assert!(matches!(**not_b, Expression::Unary("not", _)));
        let Expression::Binary(">=", sum, _) = &**comparison else { panic!("{comparison:?}") };
        let Expression::Binary("+", _, product) = &**sum else { panic!("{sum:?}") };
        assert!(matches!(**product, Expression::Binary("*", ..)));
    }

    #[test]
    fn texts_that_are_no_programs_are_refused_with_their_line() {
        for (text, words) in [
            ("", "there is no program"),
            ("x = 1\n", "line 1: a program is a function"),
            ("def f():\n  x = 1\n", "`end` is missing"),
            ("def f():\n  while True\n  end\nend\n", "line 2: `:` is missing"),
            ("def f():\n  x = (1 + \nend\n", "line 2: a value is missing"),
            ("def f():\n  x = 1 2\nend\n", "is one too many"),
            ("def f():\n  x = $\nend\n", "line 2: `$` is not known"),
            ("def f():\n  thread t():\n  end\nend\n", "`thread` is not emulated"),
            ("def f():\n  x = \"a\nend\n", "a text without its end"),
        ] {
            let told = parse(text).unwrap_err().to_string();
            assert!(told.contains(words), "{text:?}: {told}");
        }
    }
}
