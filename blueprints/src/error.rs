//! Errors of blueprint files.

use crate::BlueprintId;
use crate::assembly::impossible;
use crate::strength::Load;

/// An error in a blueprint's text or structure. Blocks are named as in the file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the fields are the values that the messages show")]
pub enum BlueprintError {
    /// The text is not TOML, a field is unknown or missing, or a value has the wrong type.
    #[error("line {line}: {message}")]
    Syntax { line: usize, message: String },
    /// The number of blocks differs from the one in the id.
    #[error("the id {id} promises {promised} blocks, the file has {n_blocks}; an id of another form promises nothing")]
    SizeMismatch { id: BlueprintId, promised: usize, n_blocks: usize },
    /// The file has no id, and none can be derived from its name.
    #[error("the file has no `id`, and no letter of its name can make one; add id = \"my-blueprint\"")]
    NoId,
    /// Too few or too many blocks.
    #[error(
        "the file has {}; a blueprint needs 2 to 16, so {}",
        counted(*.0),
        if *.0 < 2 { "add some" } else { "leave some out" }
    )]
    BadCount(usize),
    /// A text field is empty.
    #[error("field `{0}` is empty")]
    Empty(&'static str),
    /// `up` is not an axis.
    #[error("up {0:?} is not one of +x, -x, +y, -y, +z, -z")]
    BadUp(String),
    /// A block has an empty name; blocks are counted from 1.
    #[error("block {0} of the list has an empty name; give it one, or leave its `name` out")]
    EmptyBlockName(usize),
    /// Two blocks have the same name; blocks are counted from 1.
    #[error("blocks {first} and {second} of the list are both called {name:?}; give one of them another name")]
    RepeatedBlockName { name: String, first: usize, second: usize },
    /// A block lacks its type or its place.
    #[error("line {line}: block {block:?} has no `{key}`; add {what}")]
    MissingKey { line: usize, block: String, key: &'static str, what: &'static str },
    /// `at` or `size` is not three whole numbers.
    #[error("line {line}: block {block:?}: `{key}` needs three whole numbers of cells, like [2, 1, 1], and is {value}")]
    BadCells { line: usize, block: String, key: &'static str, value: String },
    /// `axes` is not a pair of distinct axes.
    #[error("block {block:?}: axes {axes:?} are not two different axes like \"+x +y\"")]
    BadAxes { block: String, axes: String },
    /// A cell is out of range.
    #[error("block {block:?}: cell {at:?} is outside -64..=64")]
    OutOfRange { block: String, at: [i64; 3] },
    /// `size` does not match the block's type.
    #[error(
        "block {block:?}: a block of type {type_name} cannot fill {size:?} cells; its sides are {cells:?} in some order"
    )]
    BadSize { block: String, type_name: String, size: [i32; 3], cells: [u8; 3] },
    /// `size` and `axes` contradict each other.
    #[error(
        "block {block:?}: turned by its axes it fills {turned:?} cells, its size is {size:?}; leave one of them out"
    )]
    SizeAndAxes { block: String, turned: [i32; 3], size: [i32; 3] },
    /// Magnets are named for a block without `axes`.
    #[error(
        "block {block:?} has no axes, and `connections` names magnets in the blocks' own frames; add its axes, or leave \
         `connections` out"
    )]
    NamedMagnets { block: String },
    /// A block overlaps others in every orientation.
    #[error(
        "block {block:?} of type {type_name} at {at:?} overlaps another block whichever way it lies; `at` is the \
         lowest-numbered corner cell"
    )]
    NoRoom { block: String, type_name: String, at: [i32; 3] },
    /// A connection refers to a block that is not in the file.
    #[error("a connection names the block {0:?}, which the file does not have")]
    UnknownBlock(String),
    /// A connection joins a block to itself.
    #[error("block {0:?} is connected to itself")]
    SelfConnection(String),
    /// A connection lists no magnets.
    #[error("the connection of {a:?} and {b:?} lists no magnets")]
    NoMagnets { a: String, b: String },
    /// A magnet pair cannot be parsed.
    #[error("magnet pair {0:?} is not of the form \"+z(0,0,0) -z(0,0,0)\"")]
    BadMagnetPair(String),
    /// A magnet pair is listed twice.
    #[error("magnet pair {pair:?} of {a:?} and {b:?} is listed twice")]
    RepeatedPair { a: String, b: String, pair: String },
    /// The inventory does not have this type.
    #[error("block {block:?} has the unknown type {type_name:?}; the inventory has {known}")]
    UnknownType { block: String, type_name: String, known: String },
    /// The file uses more blocks of a type than the inventory has.
    #[error("block {block:?} is one too many of type {type_name}: the inventory has {count}")]
    TooMany { block: String, type_name: String, count: usize },
    /// Two blocks fill one cell, given in the file's own coordinates.
    #[error("blocks {a:?} and {b:?} overlap in cell {cell:?}; move one of them")]
    Overlap { a: String, b: String, cell: [i32; 3] },
    /// Like poles face each other at a point given in the file's own coordinates.
    #[error("blocks {a:?} and {b:?} repel: like poles meet at {place_u:?}, pair \"{pair}\"; {advice}")]
    LikePoles { a: String, b: String, pair: String, place_u: [f32; 3], advice: PolesAdvice },
    /// Opposite magnets meet but the file does not list the pair.
    #[error("blocks {a:?} and {b:?} also meet with the magnets \"{pair}\"; list the pair")]
    MissingPair { a: String, b: String, pair: String },
    /// The file lists a pair that does not meet.
    #[error("the magnets \"{pair}\" of blocks {a:?} and {b:?} do not meet with opposite poles")]
    ExtraPair { a: String, b: String, pair: String },
    /// The structure is not in one piece.
    #[error("block {block:?} is not connected to {root:?}")]
    Disconnected { block: String, root: String },
    /// The structure would tip over.
    #[error(
        "the structure tips over: its center of mass is {} of what it stands on, and must be at least {min_u} u inside; \
         put more of its lowest layer under it",
        from_edge(*.margin_u)
    )]
    Unsupported { margin_u: f64, min_u: f64 },
    /// A connection carries too much load.
    #[error(
        "the connection of {a:?} and {b:?} carries {:.1} N and {:.2} N m; {n_pairs} magnet pair(s) may carry {} N and \
         {:.2} N m",
        .load.force_n,
        .load.torque_nm,
        .load.max_force_n,
        .load.max_torque_nm
    )]
    Overloaded { a: String, b: String, n_pairs: usize, load: Load },
    /// No assembly order was found; `gave_up` says that there may be one.
    #[error(
        "{} so that all stands and each block has a straight way in: blocks {blocks:?} are never reached",
        impossible(*gave_up)
    )]
    NoAssembly { blocks: Vec<String>, gave_up: bool },
}

/// Advice about two blocks that repel. An enum, because a string would make every error larger.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PolesAdvice {
    /// The file gives `axes` for at least one of the two.
    #[error("turn one, or leave out its `axes`")]
    Turn,
    /// The file gives `axes` only for other blocks, and the two already have their best rotations.
    #[error("move one, or leave out the `axes` of the blocks around them")]
    FreeOthers,
    /// The file gives `axes` for no block.
    #[error("no turns let all blocks attract, so move one, or let it lie another way with `size`")]
    Move,
}

/// Describes where a center of mass is relative to the edge of the support polygon.
fn from_edge(margin_u: f64) -> String {
    let side = if margin_u < 0.0 { "outside" } else { "inside" };
    format!("{:.2} u {side} the outline", margin_u.abs())
}

/// Formats a number of blocks.
fn counted(n_blocks: usize) -> String {
    match n_blocks {
        0 => "no blocks".to_owned(),
        1 => "1 block".to_owned(),
        n => format!("{n} blocks"),
    }
}

/// A [`BlueprintError`] and the file that caused it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}: {error}")]
pub struct BlueprintFileError {
    /// Name of the file.
    pub file: String,
    /// The error.
    #[source]
    pub error: BlueprintError,
}
