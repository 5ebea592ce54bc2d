//! The text of a case: overrides applied to it, and the way back from a value to its line.

use super::error::{CaseError, Place, nearest};
use crate::expression::ExpressionError;
use serde::de::DeserializeOwned;
use std::ops::Range;
use toml_edit::{Document, DocumentMut, Item, TableLike, Value};

/// The text of a case as run, with its overrides.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Source {
    /// Name of the file, for messages.
    pub name: String,
    /// The text as run.
    pub text: String,
    original: String,
    overrides: Vec<Override>,
}

/// A `--set key=value`, and the key under which it first added something to the text.
#[derive(Clone, Debug, PartialEq)]
struct Override {
    argument: String,
    touched: Vec<String>,
}

impl Source {
    /// The text `original` of a file called `name` with the overrides `key.key=value` applied in order.
    pub fn new(name: &str, original: &str, overrides: &[String]) -> Result<Self, CaseError> {
        let mut source = Source {
            name: name.to_owned(),
            text: original.to_owned(),
            original: original.to_owned(),
            overrides: Vec::new(),
        };
        let parsed = Document::parse(original.to_owned()).map_err(|e| {
            source.at(e.span().unwrap_or(0..0), format!("{name} is not TOML: {}", first_line(e.message())))
        })?;
        if overrides.is_empty() {
            return Ok(source);
        }
        let mut document = parsed.into_mut();
        for argument in overrides {
            let touched = set(&mut document, argument).map_err(|sentence| CaseError {
                sentence,
                hint: None,
                place: Some(Box::new(argument_place(argument))),
            })?;
            source.overrides.push(Override { argument: argument.clone(), touched });
        }
        source.text = document.to_string();
        Ok(source)
    }

    /// The text as a value of type `T`.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, CaseError> {
        toml_edit::de::from_str(&self.text).map_err(|error| {
            let span = error.span().unwrap_or(0..0);
            let formula = ExpressionError::read(error.message());
            // Of a formula show the word; the string begins with a quote.
            let part = |span: Range<usize>| match &formula {
                Some(wrong) => {
                    let start = (span.start + 1 + wrong.start).min(span.end.max(1) - 1);
                    start..(start + wrong.length).min(span.end.max(start))
                }
                None => span,
            };
            let (sentence, hint) = match &formula {
                Some(wrong) => (wrong.sentence.clone(), None),
                None => self.translate(error.message(), &span),
            };
            let mut shown = self.at(part(span), sentence);
            // An override that adds a line moves the following ones: name the line of the file as it is.
            if shown.place.as_ref().is_some_and(|p| p.line.is_some())
                && let Err(first) = toml_edit::de::from_str::<T>(&self.original)
                && first.message() == error.message()
                && let Some(span) = first.span()
            {
                shown.place = Some(Box::new(Place::in_file(&self.name, &self.original, part(span))));
            }
            shown.hint = hint;
            shown
        })
    }

    /// An error about the value at `path`, such as `stage.1.until.time`; if it is not there, about the nearest table
    /// around it.
    pub fn fault(&self, path: &str, sentence: impl Into<String>) -> CaseError {
        let keys: Vec<String> = path.split('.').map(str::to_owned).collect();
        let span = span_of(&self.text, &keys).unwrap_or(0..0);
        let mut error = self.at(span, sentence.into());
        if error.place.as_ref().is_some_and(|p| p.line.is_some())
            && let Some(span) = span_of(&self.original, &keys)
        {
            error.place = Some(Box::new(Place::in_file(&self.name, &self.original, span)));
        }
        error
    }

    /// Whether the text gives the value at `path`.
    pub fn has(&self, path: &str) -> bool {
        let keys: Vec<String> = path.split('.').map(str::to_owned).collect();
        extent_of(&self.text, &keys).is_some()
    }

    /// The first number of the text that is not finite: its path.
    pub fn not_finite(&self) -> Option<String> {
        let document = Document::parse(self.text.as_str()).ok()?;
        let mut found = None;
        visit(document.as_item(), "", &mut |path, item| {
            if found.is_none() && item.as_float().is_some_and(|x| !x.is_finite()) {
                found = Some(path.to_owned());
            }
        });
        found
    }

    fn at(&self, span: Range<usize>, sentence: String) -> CaseError {
        let blamed = self.overrides.iter().rev().find(|o| {
            extent_of(&self.text, &o.touched).is_some_and(|e| e.start <= span.start && span.end <= e.end)
        });
        let place = match blamed {
            Some(o) => argument_place(&o.argument),
            None => Place::in_file(&self.name, &self.text, span),
        };
        CaseError { sentence, hint: None, place: Some(Box::new(place)) }
    }

    /// The words of serde in the words of this program: a sentence and a hint.
    fn translate(&self, message: &str, span: &Range<usize>) -> (String, Option<String>) {
        let message = first_line(message);
        let table = self.table_at(span);
        let inside = if table.is_empty() { String::new() } else { format!(" in `{table}`") };
        let quoted = |text: &str| -> Vec<String> {
            text.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>()
        };
        for (start, noun) in [("unknown field", "key"), ("unknown variant", "choice")] {
            if let Some(rest) = message.strip_prefix(start) {
                let words = quoted(rest);
                let Some((word, allowed)) = words.split_first() else { break };
                let mut hint = format!("allowed here: {}", allowed.join(", "));
                if let Some(near) = nearest(word, allowed.iter().map(String::as_str)) {
                    hint = format!("did you mean {near}? {hint}");
                }
                return (format!("unknown {noun} `{word}`{inside}"), Some(hint));
            }
        }
        if let Some(key) = message.strip_prefix("missing field ") {
            let table = self.item_at(span).unwrap_or(table);
            let inside = if table.is_empty() { String::new() } else { format!(" in `{table}`") };
            return (format!("the key {key} is missing{inside}"), None);
        }
        if let Some((found, expected)) = message
            .strip_prefix("invalid type: ")
            .or(message.strip_prefix("invalid value: "))
            .and_then(|rest| rest.split_once(", expected "))
        {
            return (format!("expected {}, found {}{inside}", plain(expected), plain(found)), None);
        }
        (message.to_owned(), None)
    }

    /// The dotted name of the table that takes exactly the bytes `span`.
    fn item_at(&self, span: &Range<usize>) -> Option<String> {
        let document = Document::parse(self.text.as_str()).ok()?;
        let mut found = None;
        visit(document.as_item(), "", &mut |path, item| {
            if item.is_table_like() && item.span().as_ref() == Some(span) {
                found = Some(path.to_owned());
            }
        });
        found
    }

    /// The dotted name of the innermost table around `span`.
    fn table_at(&self, span: &Range<usize>) -> String {
        let Ok(document) = Document::parse(self.text.as_str()) else { return String::new() };
        let mut best = (usize::MAX, String::new());
        visit(document.as_item(), "", &mut |path, item| {
            let Some(table) = item.as_table_like() else { return };
            for (name, inner) in table.iter() {
                let key = table.key(name).and_then(|k| k.span());
                for range in [key, inner.span()].into_iter().flatten() {
                    if range.start <= span.start && span.end <= range.end && range.len() < best.0 {
                        best = (range.len(), path.to_owned());
                    }
                }
            }
        });
        best.1
    }
}

/// Puts `key.key=value` into the document and returns the path of what was added or replaced.
fn set(document: &mut DocumentMut, argument: &str) -> Result<Vec<String>, String> {
    let Some((path, value)) = argument.split_once('=') else {
        return Err(format!("`--set {argument}` has no `=`: write --set key.key=value"));
    };
    let keys: Vec<&str> = path.split('.').map(str::trim).collect();
    if keys.iter().any(|k| k.is_empty()) {
        return Err(format!("`--set {argument}` has an empty key: write --set key.key=value"));
    }
    // What is no TOML value is taken as a string, so that nobody needs to quote twice for the shell.
    let value: Value = value.trim().parse().unwrap_or_else(|_| Value::from(value.trim()));
    let mut touched = Vec::new();
    set_in_table(document.as_table_mut(), &keys, value, &mut touched)?;
    Ok(touched)
}

fn set_in_table(
    table: &mut dyn TableLike,
    keys: &[&str],
    mut value: Value,
    touched: &mut Vec<String>,
) -> Result<(), String> {
    let Some((key, rest)) = keys.split_first() else {
        return Err(format!("`{}` is a table: name one of its keys", touched.join(".")));
    };
    touched.push((*key).to_owned());
    match table.get_mut(key) {
        Some(item) if !rest.is_empty() => set_in_item(item, rest, value, touched),
        Some(item) => {
            if let Some(old) = item.as_value() {
                *value.decor_mut() = old.decor().clone();
            }
            *item = Item::Value(value);
            Ok(())
        }
        None => {
            for inner in rest.iter().rev() {
                let mut around = toml_edit::InlineTable::new();
                around.insert(*inner, value);
                value = Value::InlineTable(around);
            }
            table.insert(key, Item::Value(value));
            Ok(())
        }
    }
}

fn set_in_item(
    item: &mut Item,
    keys: &[&str],
    value: Value,
    touched: &mut Vec<String>,
) -> Result<(), String> {
    let outer = touched.join(".");
    match item {
        Item::ArrayOfTables(tables) => {
            let named = |t: &toml_edit::Table| t.get("name").and_then(Item::as_str) == Some(keys[0]);
            let index = keys[0].parse().ok().or_else(|| tables.iter().position(named));
            let Some((index, table)) = index.and_then(|k: usize| Some((k, tables.get_mut(k)?))) else {
                return Err(format!("there is no `{outer}.{}` to set", keys[0]));
            };
            touched.push(index.to_string());
            set_in_table(table, &keys[1..], value, touched)
        }
        Item::Value(Value::Array(array)) => {
            let index = keys[0].parse().ok().filter(|&k: &usize| k < array.len() && keys.len() == 1);
            let Some(index) = index else {
                return Err(format!("there is no `{outer}.{}` to set", keys.join(".")));
            };
            touched.push(index.to_string());
            array.replace(index, value);
            Ok(())
        }
        _ => match item.as_table_like_mut() {
            Some(table) => set_in_table(table, keys, value, touched),
            None => Err(format!("`{outer}` is a value, not a table: it has no key `{}`", keys[0])),
        },
    }
}

/// The place of an override on the command line.
fn argument_place(argument: &str) -> Place {
    let text = format!("--set {argument}");
    Place { source: "--set".into(), line: None, column: 7, width: argument.chars().count().max(1), text }
}

/// The bytes of the value at `keys`, or of the deepest value around it that exists.
fn span_of(text: &str, keys: &[String]) -> Option<Range<usize>> {
    let document = Document::parse(text).ok()?;
    let mut span = None;
    follow(document.as_item(), keys, &mut |key, item| {
        // Of a table with a header show the header, of a table written with dots its first key.
        let whole =
            if item.is_table() { item.as_table().and_then(toml_edit::Table::span) } else { item.span() };
        span = whole.or(key).or(span.clone());
    });
    span
}

/// The bytes of `keys = value`, all of it.
fn extent_of(text: &str, keys: &[String]) -> Option<Range<usize>> {
    let document = Document::parse(text).ok()?;
    let mut depth = 0;
    let mut extent = None;
    follow(document.as_item(), keys, &mut |key, item| {
        depth += 1;
        let end = item.span().map(|s| s.end);
        let start = key.or(item.span()).map(|s| s.start);
        extent = start.zip(end).map(|(start, end)| start..end);
    });
    extent.filter(|_| depth == keys.len())
}

/// Walks down `keys` as far as they exist; at each level gives the bytes of the key and the item.
fn follow(item: &Item, keys: &[String], each: &mut dyn FnMut(Option<Range<usize>>, &Item)) {
    let Some((key, rest)) = keys.split_first() else { return };
    let index = key.parse::<usize>().ok();
    match item {
        Item::ArrayOfTables(tables) => {
            if let Some(table) = index.and_then(|k| tables.get(k)) {
                let inner = Item::Table(table.clone());
                each(None, &inner);
                follow(&inner, rest, each);
            }
        }
        Item::Value(Value::Array(array)) => {
            if let Some(value) = index.and_then(|k| array.get(k)) {
                let inner = Item::Value(value.clone());
                each(None, &inner);
                follow(&inner, rest, each);
            }
        }
        _ => {
            if let Some(table) = item.as_table_like()
                && let (Some(name), Some(inner)) = (table.key(key), table.get(key))
            {
                each(name.span(), inner);
                follow(inner, rest, each);
            }
        }
    }
}

/// Every value of the document with its path.
fn visit(item: &Item, path: &str, each: &mut dyn FnMut(&str, &Item)) {
    each(path, item);
    let below = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match item {
        Item::ArrayOfTables(tables) => {
            for (k, table) in tables.iter().enumerate() {
                visit(&Item::Table(table.clone()), &below(&k.to_string()), each);
            }
        }
        Item::Value(Value::Array(array)) => {
            for (k, value) in array.iter().enumerate() {
                visit(&Item::Value(value.clone()), &below(&k.to_string()), each);
            }
        }
        _ => {
            for (key, inner) in item.as_table_like().into_iter().flat_map(|t| t.iter()) {
                visit(inner, &below(key), each);
            }
        }
    }
}

/// `invalid type` as a person would say it.
fn plain(words: &str) -> String {
    let words = words.trim();
    for (rust, word) in [
        ("f64", "a number"),
        ("u64", "a whole number, 0 or more"),
        ("u32", "a whole number, 0 or more"),
        ("usize", "a whole number, 0 or more"),
        ("a boolean", "true or false"),
        ("map", "a table"),
        ("sequence", "a list"),
    ] {
        if words == rust {
            return word.to_owned();
        }
    }
    if words.starts_with("struct ") || words.contains("externally tagged enum") || words.starts_with("enum ")
    {
        return "a table".to_owned();
    }
    if let Some(size) = words.strip_prefix("an array of length ") {
        return format!("a list of {size} numbers");
    }
    for (rust, word) in [
        ("string ", "the text "),
        ("floating point ", "the number "),
        ("integer ", "the number "),
        ("boolean ", ""),
    ] {
        if let Some(rest) = words.strip_prefix(rust) {
            return format!("{word}{rest}");
        }
    }
    words.to_owned()
}

fn first_line(text: &str) -> &str {
    text.lines().next().unwrap_or("").trim()
}
