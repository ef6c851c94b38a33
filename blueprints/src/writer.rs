//! Writes blueprints as TOML, in the style of the catalog.

use std::fmt::Write as _;

use crate::format::MagnetName;
use crate::{Blueprint, Inventory, Placement};

/// Block names in written files, by type name; other types use the type name.
const NAMES: [(&str, &str); 6] =
    [("1x1x1", "cube"), ("2x1x1", "brick"), ("3x1x1", "bar"), ("4x1x1", "beam"), ("2x2x1", "tile"), ("3x2x1", "slab")];

/// Returns the everyday word for a type of block, for example `cube`.
pub fn word(type_name: &str) -> &str {
    NAMES.iter().find(|(of, _)| *of == type_name).map_or(type_name, |(_, word)| word)
}

/// Returns the word for the `i`-th of the types, numbered from 1 after `separator` if the type occurs more than once.
pub(crate) fn numbered(types: &[&str], i: usize, separator: char) -> String {
    let same = |range: &[&str]| range.iter().filter(|name| **name == types[i]).count();
    let word = word(types[i]);
    if same(types) == 1 { word.to_owned() } else { format!("{word}{separator}{}", same(&types[..=i])) }
}

impl Blueprint {
    /// Returns the text of the blueprint's file; `provenance` states the origin of the structure.
    ///
    /// Blocks are named after their types, numbered from 1 if a type occurs more than once. Parsing the text gives an
    /// equal blueprint if this one uses the first blocks of every type, as every blueprint from a file does. After
    /// [`permuted`](Self::permuted), the text parses as the same structure on the first blocks.
    pub fn to_toml(&self, provenance: &str) -> String {
        let type_of = |placement: &Placement| Inventory::standard().block_type(placement.block).name;
        let types: Vec<&str> = self.placements().iter().map(type_of).collect();
        let names: Vec<String> = (0..types.len()).map(|i| numbered(&types, i, '-')).collect();
        self.to_toml_with(&names, provenance)
    }

    /// Like [`to_toml`](Self::to_toml), with other block names, in the order of the placements.
    pub(crate) fn to_toml_with(&self, names: &[String], provenance: &str) -> String {
        let inventory = Inventory::standard();
        // Quote the names by TOML's rules for quotes and control characters.
        let names: Vec<String> = names.iter().map(|name| toml::Value::from(&name[..]).to_string()).collect();
        let width = names.iter().map(String::len).max().unwrap_or(0);
        let mut text = format!("id = \"{}\"\nsplit = \"{}\"\n", self.id(), self.split());
        for (key, value) in [("title", self.title()), ("provenance", provenance)] {
            let _ = writeln!(text, "{key} = {}", toml::Value::from(value));
        }
        text.push_str("up = \"+z\"\n\nblocks = [\n");
        for (name, placement) in names.iter().zip(self.placements()) {
            let at = placement.lowest_cell();
            let type_name = inventory.block_type(placement.block).name;
            let axes = placement.rotation.axes();
            let name = format!("{name},");
            let _ = writeln!(
                text,
                "    {{ name = {name:<0$} type = \"{type_name}\", at = {at:?}, axes = \"{axes}\" }},",
                width + 1
            );
        }
        text.push_str("]\n\nconnections = [\n");
        let name = |block| &names[self.placements().iter().take_while(|p| p.block != block).count()];
        for link in self.links() {
            let pairs: Vec<String> = (inventory.magnet_pairs(link.a, link.b, link.relative).into_iter())
                .map(|(p, q)| format!("\"{} {}\"", MagnetName::of(link.a, p), MagnetName::of(link.b, q)))
                .collect();
            let _ = write!(text, "    {{ a = {}, b = {}, magnets = [", name(link.a), name(link.b));
            match &pairs[..] {
                [pair] => text.push_str(pair),
                _ => {
                    text.push('\n');
                    pairs.iter().for_each(|pair| text.push_str(&format!("        {pair},\n")));
                    text.push_str("    ");
                }
            }
            text.push_str("] },\n");
        }
        text.push_str("]\n");
        text
    }
}

#[cfg(test)]
mod tests {
    use crate::checks::check_text;
    use crate::{Blueprint, Catalog};

    #[test]
    fn written_blueprints_parse_back() {
        for blueprint in Catalog::builtin().iter() {
            let text = blueprint.to_toml("a \"test\"");
            assert_eq!(check_text("written.toml", &text).blueprint.as_ref(), Ok(blueprint), "{text}");
        }
    }

    #[test]
    fn text_matches_the_catalog_style() {
        let text = "id = \"2_001\"\nsplit = \"train\"\ntitle = \"a \\\\ b\"\nprovenance = \"by hand\"\nup = \"+z\"\n\n\
                    blocks = [\n    { name = \"cube\", type = \"1x1x1\", at = [0, 0, 1], axes = \"-x +y\" },\n    \
                    { name = \"beam\", type = \"4x1x1\", at = [0, 0, 0], axes = \"+x -y\" },\n]\n\n\
                    connections = [\n    { a = \"cube\", b = \"beam\", magnets = [\"+z(0,0,0) -z(0,0,0)\"] },\n]\n";
        let blueprint: Blueprint = check_text("cube.toml", text).blueprint.unwrap();
        assert_eq!(blueprint.to_toml("by hand"), text.replace("\"a \\\\ b\"", "'a \\ b'"));
    }
}
