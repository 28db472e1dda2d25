//! The protocol document is what the words say.

#[path = "protocol/document.rs"]
mod document;

use std::path::Path;

use document::{COMMAND, FILE, answers, document, requests, variants};

/// The first word of a debug text.
fn name(debug: String) -> String {
    debug.chars().take_while(|c| c.is_alphanumeric()).collect()
}

#[test]
fn the_document_is_what_the_words_say() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(FILE);
    let written = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(written == document(), "{FILE} is not what the words say; renew it with: {COMMAND}");
}

#[test]
fn every_word_has_an_example() {
    let said: Vec<String> = requests().iter().map(|request| name(format!("{:?}", request.command))).collect();
    assert_eq!(said, variants("Command"));
    let said: Vec<String> = answers().iter().map(|answer| name(format!("{:?}", answer.reply))).collect();
    assert_eq!(said, variants("Reply"));
}
