//! Error messages for files that are not text and for paths without blueprints.

use super::*;

#[test]
fn bytes_that_are_no_text_are_named_with_their_line() {
    let message = |bytes: &[u8]| text_of(Path::new("mine.toml"), bytes.to_vec()).unwrap_err().to_string();
    // Latin-1 encodes ü as one byte.
    let latin = message(b"id = \"mine\"\ntitle = \"T\xfcr\"");
    assert_eq!(latin, "mine.toml is not UTF-8 text: line 2 has the byte 0xfc; save it as UTF-8");
    let utf16 = message(b"\xff\xfei\0d\0");
    assert_eq!(utf16, "mine.toml is not UTF-8 text: line 1 has the byte 0xff; save it as UTF-8");
    // The first byte of a two-byte character, at the end.
    assert!(message(b"title = \"T\xc3").contains("line 1 has the byte 0xc3"));
    assert_eq!(text_of(Path::new("mine.toml"), "Tür".into()).unwrap(), "Tür");
}

#[test]
fn a_path_without_blueprints_is_not_an_empty_list() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let message = read_files(&folder).unwrap_err().to_string();
    assert_eq!(
        message,
        format!("the folder {} holds no blueprint; name one with files called *.toml", folder.display())
    );
    assert_eq!(Catalog::load(&folder).unwrap_err().to_string(), message);
    let nowhere = folder.join("nowhere");
    let message = read_files(&nowhere).unwrap_err().to_string();
    assert_eq!(message, format!("cannot read {}: there is no such file or folder", nowhere.display()));
}

#[test]
fn hidden_names_in_a_folder_are_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let (name, text) = BUILTIN_FILES[0];
    fs::write(folder.path().join(name), text).unwrap();
    // What editors and file systems leave beside a file: a lock that points nowhere, and bytes of their own.
    std::os::unix::fs::symlink("nobody@nowhere.1", folder.path().join(format!(".#{name}"))).unwrap();
    let copy = folder.path().join(format!("._{name}"));
    fs::write(&copy, b"\0\x05\x16\x07\xff").unwrap();
    let names: Vec<String> = read_files(folder.path()).unwrap().into_iter().map(|(name, _)| name).collect();
    assert_eq!(names, [folder.path().join(name).display().to_string()]);
    assert_eq!(Catalog::load(folder.path()).unwrap().len(), 1);
    // A file that is named is read, whatever it is called.
    let refused = |path: &Path| read_files(path).unwrap_err().to_string();
    assert!(refused(&copy).contains("is not UTF-8 text"));
    fs::remove_file(folder.path().join(name)).unwrap();
    assert!(refused(folder.path()).contains("holds no blueprint"));
}
