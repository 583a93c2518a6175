//! What is no command at all, and what can be read of it nevertheless.

use crawler_protocol::{Command, MAX_MESSAGE, Reason};

#[test]
fn what_is_not_one_json_object_is_malformed_or_of_the_wrong_type() {
    let tail = r#""timestamp":1,"seq":17,"source":"a"}"#;
    let malformed = [
        String::new(),
        " \n".into(),
        "nul".into(),
        "{".into(),
        "{}{}".into(),
        "\u{feff}{}".into(),
        format!(r#"{{"command":"stop",{tail} "#) + "x",
        format!(r#"{{"command":"stop",,{tail}"#),
        format!(r#"{{command:"stop",{tail}"#),
        format!("{{'command':'stop',{tail}"),
        format!("{{\"command\":\"st\nop\",{tail}"),
        format!(r#"{{"command":"\x",{tail}"#),
        format!(r#"{{"command":"\ud83e",{tail}"#),
        format!(r#"{{"command":"\ud83ex\udd16",{tail}"#),
        format!(r#"{{"command":"\udd16",{tail}"#),
        format!(r#"{{"command":"\ud83e\ud83e",{tail}"#),
        format!(r#"{{"command":"\u00g0",{tail}"#),
        format!(r#"{{"command":"\u+123",{tail}"#),
        format!(r#"{{"command":"drive","parameters":{{"v":NaN,"w":0}},{tail}"#),
        format!(r#"{{"command":"drive","parameters":{{"v":Infinity,"w":0}},{tail}"#),
        format!(r#"{{"command":"drive","parameters":{{"v":+1,"w":0}},{tail}"#),
        format!(r#"{{"command":"drive","parameters":{{"v":01,"w":0}},{tail}"#),
        format!(r#"{{"command":"drive","parameters":{{"v":.5,"w":0}},{tail}"#),
        format!(r#"{{"command":"drive","parameters":{{"v":5.,"w":0}},{tail}"#),
        format!(r#"{{"command":"drive","parameters":{{"v":1e,"w":0}},{tail}"#),
        format!(r#"{{"command":"drive","parameters":{{"v":0x1,"w":0}},{tail}"#),
        format!(r#"{{"command":"drive","parameters":{{"v":1,"w":0,}},{tail}"#),
        format!(r#"{{"command":"stop","x":[1,],{tail}"#),
        format!(r#"{{"command":"stop","x":truely,{tail}"#),
        format!(r#"{{"command":"stop",{}"#, tail.replace('}', ",}")),
    ];
    for json in malformed {
        assert_eq!(
            Command::parse(json.as_bytes()).unwrap_err().reason,
            Reason::Malformed,
            "{json}"
        );
    }
    for json in ["17", "null", "true", r#""stop""#, "[]", r#"["command"]"#] {
        assert_eq!(
            Command::parse(json.as_bytes()).unwrap_err().reason,
            Reason::WrongType,
            "{json}"
        );
    }
    let mut bytes = br#"{"seq":17,"source":"a","command":"st?p","timestamp":1}"#.to_vec();
    let at = bytes.iter().position(|byte| *byte == b'?').unwrap();
    bytes[at] = 0xc0;
    let error = Command::parse(&bytes).unwrap_err();
    assert_eq!((error.reason, error.seq), (Reason::Malformed, Some(17)));
    assert_eq!(error.source.unwrap().as_str(), "a");
}

#[test]
fn a_number_cut_off_is_not_taken_for_the_number_sent() {
    let error = Command::parse(br#"{"source":"a","seq":12"#).unwrap_err();
    assert_eq!((error.reason, error.seq), (Reason::Malformed, None));
    let error = Command::parse(br#"{"source":"a","seq":12,"#).unwrap_err();
    assert_eq!((error.reason, error.seq), (Reason::Malformed, Some(12)));
    assert!(error.source.is_some());
}

#[test]
fn a_command_of_more_than_1024_bytes_is_too_large() {
    let front = r#"{"command":"stop","timestamp":1,"seq":17,"source":"a""#;
    for length in [MAX_MESSAGE, MAX_MESSAGE + 1, 100_000] {
        let mut json = front.to_owned();
        json.push_str(&" ".repeat(length - json.len() - 1));
        json.push('}');
        let result = Command::parse(json.as_bytes());
        if length == MAX_MESSAGE {
            assert!(result.is_ok());
        } else {
            let error = result.unwrap_err();
            assert_eq!((error.reason, error.seq), (Reason::TooLarge, Some(17)));
            assert!(error.source.is_some());
        }
    }
}
