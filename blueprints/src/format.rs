//! The TOML format of blueprint files, one structure per file. `docs/blueprints.md` documents it, and a test checks
//! the files shown there.

use std::collections::BTreeSet;

use serde::Deserialize;
use toml::{Spanned, Value};

use crate::error::BlueprintError::{self, Invalid};
use crate::placement::move_to_origin;
use crate::{BlockIdx, BlueprintId, CubeRotation, Inventory, N_BLOCKS, Placement, Split};

/// Maximum absolute coordinate of a cell in a file, which prevents overflow in sums.
pub const MAX_COORDINATE: i32 = 64;

/// A block as written in a file, not yet assigned to an inventory block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DraftBlock {
    pub(crate) name: String,
    pub(crate) type_name: String,
    pub(crate) at: [i32; 3],
    /// Rotation, if the file gives it.
    pub(crate) turn: Option<CubeRotation>,
    /// Cells along the drawing's axes, if the file gives them.
    pub(crate) size: Option<[i32; 3]>,
}

/// A magnet as written in a file: face as a signed axis, cell in the block's own frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct MagnetName {
    pub(crate) normal: [i32; 3],
    pub(crate) cell: [i32; 3],
}

/// A magnet pair as written: two blocks by their index in the file, smaller first, and a magnet of each.
pub(crate) type NamedPair = (usize, usize, MagnetName, MagnetName);

/// A parsed file with valid values, whose structure is not yet checked.
#[derive(Clone, Debug)]
pub(crate) struct Draft {
    pub(crate) id: BlueprintId,
    pub(crate) split: Split,
    pub(crate) title: String,
    pub(crate) up: [i32; 3],
    /// Origin of the structure, if the file gives it.
    pub(crate) provenance: Option<String>,
    pub(crate) blocks: Vec<DraftBlock>,
    /// Magnet pairs in the file; `None` stands for all magnets that meet.
    pub(crate) pairs: Option<BTreeSet<NamedPair>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFile {
    id: Option<BlueprintId>,
    split: Option<Split>,
    title: Option<String>,
    provenance: Option<String>,
    up: Option<String>,
    blocks: Vec<Spanned<RawBlock>>,
    connections: Option<Vec<RawConnection>>,
}

/// All fields are optional and numbers may be of any type, so that errors can name the block.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "a block like { type = \"1x1x1\", at = [0, 0, 0] }")]
struct RawBlock {
    name: Option<String>,
    #[serde(rename = "type")]
    type_name: Option<String>,
    at: Option<Spanned<Value>>,
    axes: Option<String>,
    size: Option<Spanned<Value>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "a connection like { a = \"foot\", b = \"post\", magnets = [] }")]
struct RawConnection {
    a: String,
    b: String,
    magnets: Vec<String>,
}

impl Draft {
    /// Parses a file's text and reports errors of form, not of structure. The file name provides a missing id.
    pub(crate) fn parse(file: &str, text: &str) -> Result<Self, BlueprintError> {
        let raw: RawFile = toml::from_str(text).map_err(|error| syntax_error(text, &error))?;
        let id = raw.id.or_else(|| BlueprintId::of_file(file)).ok_or_else(|| {
            Invalid(
                "the file has no `id`, and no letter of its name can make one; add id = \"my-blueprint\"".to_owned(),
            )
        })?;
        let n_blocks = raw.blocks.len();
        if let Some(promised) = id.size().filter(|promised| *promised != n_blocks) {
            return Err(Invalid(format!(
                "the id {id} promises {promised} blocks, the file has {n_blocks}; an id of another form promises nothing"
            )));
        }
        // Check this before any work that grows with the number of blocks.
        if !(2..=N_BLOCKS).contains(&n_blocks) {
            let (counted, advice) = match n_blocks {
                0 => ("no blocks".to_owned(), "add some"),
                1 => ("1 block".to_owned(), "add some"),
                n => (format!("{n} blocks"), "leave some out"),
            };
            return Err(Invalid(format!("the file has {counted}; a blueprint needs 2 to 16, so {advice}")));
        }
        for (field, value) in [("title", &raw.title), ("provenance", &raw.provenance)] {
            if value.as_ref().is_some_and(|value| value.trim().is_empty()) {
                return Err(Invalid(format!("field `{field}` is empty")));
            }
        }
        let up = raw.up.unwrap_or_else(|| "+z".to_owned());
        let bad_up = || Invalid(format!("up {up:?} is not one of +x, -x, +y, -y, +z, -z"));
        let up = parse_axis(&up).ok_or_else(bad_up)?;
        let mut blocks: Vec<DraftBlock> = Vec::new();
        for (i, block) in raw.blocks.into_iter().enumerate() {
            let block = parse_block(text, block, i)?;
            if block.name.is_empty() {
                let at = i + 1;
                return Err(Invalid(format!(
                    "block {at} of the list has an empty name; give it one, or leave its `name` out"
                )));
            }
            if let Some(other) = blocks.iter().position(|other| other.name == block.name) {
                let (first, second) = (other + 1, i + 1);
                let name = block.name;
                return Err(Invalid(format!(
                    "blocks {first} and {second} of the list are both called {name:?}; give one of them another name"
                )));
            }
            blocks.push(block);
        }
        let pairs = raw.connections.map(|connections| parse_pairs(connections, &blocks)).transpose()?;
        let title = raw.title.unwrap_or_else(|| id.to_string());
        let split = raw.split.unwrap_or(Split::Train);
        Ok(Self { id, split, title, up, provenance: raw.provenance, blocks, pairs })
    }

    /// Assigns an inventory block to each block of the file: the k-th of a type gets the k-th in the inventory.
    pub(crate) fn assign(&self) -> Result<Vec<BlockIdx>, BlueprintError> {
        let inventory = Inventory::standard();
        let mut assigned = Vec::with_capacity(self.blocks.len());
        for (i, block) in self.blocks.iter().enumerate() {
            let DraftBlock { name, type_name, .. } = block;
            let same = inventory.blocks_of_type(type_name);
            if same.is_empty() {
                let known = inventory.types().iter().map(|t| t.name).collect::<Vec<_>>().join(", ");
                return Err(Invalid(format!(
                    "block {name:?} has the unknown type {type_name:?}; the inventory has {known}"
                )));
            }
            let n_before = self.blocks[..i].iter().filter(|other| other.type_name == *type_name).count();
            let count = same.len();
            let too_many =
                || Invalid(format!("block {name:?} is one too many of type {type_name}: the inventory has {count}"));
            assigned.push(*same.get(n_before).ok_or_else(too_many)?);
        }
        Ok(assigned)
    }

    /// Places assigned blocks with their rotations, then rotates and moves the drawing so that `up` is +z and its
    /// lowest corner is at the origin. Placements are in file order.
    pub(crate) fn place(&self, assigned: &[BlockIdx], turns: &[CubeRotation]) -> Vec<Placement> {
        let upright = self.upright();
        let place = |((block, &idx), &turn): ((&DraftBlock, &BlockIdx), &CubeRotation)| {
            let size = turn.apply(Inventory::standard().cells(idx).map(i32::from)).map(i32::abs);
            let center = std::array::from_fn(|k| 2 * block.at[k] + size[k]);
            Placement { block: idx, center_half_units: upright.apply(center), rotation: upright.compose(turn) }
        };
        let mut placements: Vec<_> = self.blocks.iter().zip(assigned).zip(turns).map(place).collect();
        move_to_origin(&mut placements);
        placements
    }

    /// Converts a point of the placed blocks to the file's coordinates, for messages; both in half units.
    pub(crate) fn drawn(&self, point: [i32; 3], placements: &[Placement]) -> [i32; 3] {
        let back = self.upright().inverse();
        let turned = back.apply(point);
        // The first block's center, rotated back, differs from its center as drawn by the distance the drawing was
        // moved.
        self.blocks.iter().zip(placements).next().map_or(turned, |(block, placement)| {
            let center = back.apply(placement.center_half_units);
            let size = back.apply(placement.size_cells());
            std::array::from_fn(|k| turned[k] - center[k] + 2 * block.at[k] + size[k].abs())
        })
    }

    /// Returns the rotation that maps `up` to +z.
    fn upright(&self) -> CubeRotation {
        CubeRotation::all().find(|r| r.apply(self.up) == [0, 0, 1]).unwrap_or(CubeRotation::IDENTITY)
    }
}

impl MagnetName {
    /// Returns the name of a block's `k`-th magnet.
    pub(crate) fn of(block: BlockIdx, k: usize) -> Self {
        let inventory = Inventory::standard();
        let cells = inventory.cells(block).map(i32::from);
        let magnet = inventory.magnets(block)[k];
        // The cell's center lies half a cell inside the face.
        let cell = std::array::from_fn(|k| (magnet.position_half_units[k] - magnet.normal[k] + cells[k] - 1) / 2);
        Self { normal: magnet.normal, cell }
    }

    fn parse(text: &str) -> Option<Self> {
        let (face, cell) = text.strip_suffix(')')?.split_once('(')?;
        let cell: Vec<i32> = cell.split(',').map(|n| n.trim().parse().ok()).collect::<Option<_>>()?;
        Some(Self { normal: parse_axis(face)?, cell: cell.try_into().ok()? })
    }
}

impl std::fmt::Display for MagnetName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let axis = self.normal.iter().position(|&x| x != 0).unwrap_or(0);
        let sign = if self.normal[axis] > 0 { '+' } else { '-' };
        let [x, y, z] = self.cell;
        write!(f, "{sign}{}({x},{y},{z})", ["x", "y", "z"][axis])
    }
}

/// Parses the `i`-th block of the file with this `text`. A block without a name is named after its position.
fn parse_block(text: &str, raw: Spanned<RawBlock>, i: usize) -> Result<DraftBlock, BlueprintError> {
    let line = line_at(text.as_bytes(), raw.span().start);
    let RawBlock { name, type_name, at, axes, size } = raw.into_inner();
    let name = name.unwrap_or_else(|| format!("block-{}", i + 1));
    let missing = |key, what| Invalid(format!("line {line}: block {name:?} has no `{key}`; add {what}"));
    let type_name = type_name.ok_or_else(|| missing("type", "its size in cells, like type = \"2x1x1\""))?;
    let what = "the lowest-numbered corner cell that it fills, like at = [0, 0, 0]";
    let drawn_at = at.ok_or_else(|| missing("at", what))?;
    let bad_cells = |key, value: &Spanned<Value>| {
        let line = line_at(text.as_bytes(), value.span().start);
        let value = brief(value.get_ref());
        Invalid(format!(
            "line {line}: block {name:?}: `{key}` needs three whole numbers of cells, like [2, 1, 1], and is {value}"
        ))
    };
    let at = whole_numbers(drawn_at.get_ref()).ok_or_else(|| bad_cells("at", &drawn_at))?;
    let is_near = |at: &[i32; 3]| at.iter().all(|x| (-MAX_COORDINATE..=MAX_COORDINATE).contains(x));
    let near = narrow(at).filter(is_near);
    let at = near.ok_or_else(|| BlueprintError::out_of_range(&name, at))?;
    let parse_size =
        |size: &Spanned<Value>| whole_numbers(size.get_ref()).and_then(narrow).ok_or_else(|| bad_cells("size", size));
    let size = size.as_ref().map(parse_size).transpose()?;
    let parse_axes =
        |axes: String| CubeRotation::from_axes(&axes).ok_or_else(|| BlueprintError::bad_axes(&name, &axes));
    let turn = axes.map(parse_axes).transpose()?;
    Ok(DraftBlock { name, type_name, at, turn, size })
}

fn parse_pairs(connections: Vec<RawConnection>, blocks: &[DraftBlock]) -> Result<BTreeSet<NamedPair>, BlueprintError> {
    let find = |name: &str| {
        let position = blocks.iter().position(|block| block.name == name);
        let unknown = || Invalid(format!("a connection names the block {name:?}, which the file does not have"));
        position.ok_or_else(unknown)
    };
    let mut pairs = BTreeSet::new();
    for RawConnection { a, b, magnets } in connections {
        let (i, j) = (find(&a)?, find(&b)?);
        if i == j {
            return Err(Invalid(format!("block {a:?} is connected to itself")));
        }
        if magnets.is_empty() {
            return Err(Invalid(format!("the connection of {a:?} and {b:?} lists no magnets")));
        }
        if let Some(open) = [i, j].into_iter().find(|&i| blocks[i].turn.is_none()) {
            let block = &blocks[open].name;
            return Err(Invalid(format!(
                "block {block:?} has no axes, and `connections` names magnets in the blocks' own frames; add its axes, or \
                 leave `connections` out"
            )));
        }
        for text in magnets {
            let parsed = text.split_once(' ').and_then(|(p, q)| Some((MagnetName::parse(p)?, MagnetName::parse(q)?)));
            let bad = || Invalid(format!("magnet pair {text:?} is not of the form \"+z(0,0,0) -z(0,0,0)\""));
            let (p, q) = parsed.ok_or_else(bad)?;
            if !pairs.insert(if i < j { (i, j, p, q) } else { (j, i, q, p) }) {
                return Err(Invalid(format!("magnet pair {text:?} of {a:?} and {b:?} is listed twice")));
            }
        }
    }
    Ok(pairs)
}

/// Returns the value as three whole numbers, if it is that.
fn whole_numbers(value: &Value) -> Option<[i64; 3]> {
    let [x, y, z] = &value.as_array()?[..] else { return None };
    Some([x.as_integer()?, y.as_integer()?, z.as_integer()?])
}

/// Narrows the numbers to `i32`, if they are small enough.
fn narrow(numbers: [i64; 3]) -> Option<[i32; 3]> {
    let [x, y, z] = numbers.map(i32::try_from);
    Some([x.ok()?, y.ok()?, z.ok()?])
}

/// Formats a value for a message, on one line and cut off if it is long.
fn brief(value: &Value) -> String {
    const MOST: usize = 60;
    let text = value.to_string();
    let short: String = text.chars().take(MOST).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if text.chars().count() > MOST { short + "…" } else { short }
}

/// Parses a signed axis such as `+x` or `-y`.
fn parse_axis(text: &str) -> Option<[i32; 3]> {
    let [sign, axis] = text.as_bytes() else { return None };
    let sign = match sign {
        b'+' => 1,
        b'-' => -1,
        _ => return None,
    };
    let axis = b"xyz".iter().position(|known| known == axis)?;
    Some(std::array::from_fn(|i| if i == axis { sign } else { 0 }))
}

/// Returns the parser's message on one line, with the line number of the error.
fn syntax_error(text: &str, error: &toml::de::Error) -> BlueprintError {
    let line = line_at(text.as_bytes(), error.span().map_or(0, |span| span.start));
    Invalid(format!("line {line}: {}", error.message().replace('\n', ", ")))
}

/// Returns the line of the byte at `at`, counted from 1.
pub(crate) fn line_at(text: &[u8], at: usize) -> usize {
    1 + text.iter().take(at).filter(|&&byte| byte == b'\n').count()
}

#[cfg(test)]
mod tests;
