//! Plots of hand-made histories.

use blueprints::Split;

use super::*;
use proto::ActionMode;
use runlog::Pass;
use runlog::series::{Difference, Grid, lineage};
use samples::pass;

#[path = "../../../runlog/src/history/samples.rs"]
mod samples;

fn two_passes() -> Vec<Pass> {
    let score = |two, sixteen| [("2_000", Split::Train, 2, two), ("test_16_000", Split::Test, 16, sixteen)];
    vec![pass(0, &score(0, 0)), pass(40_000, &score(10, 0))]
}

fn map_of(passes: &[Pass]) -> String {
    let grid = Grid::success(&lineage(passes), ActionMode::Greedy).unwrap();
    success_map(&grid, "What & where", "of < a run >").to_svg()
}

/// Upper left corner, width, and fill of the rectangles with a row's height in an SVG.
fn cells(svg: &str, height: &str) -> Vec<([u32; 2], u32, String)> {
    let rects = svg.lines().filter(|line| line.starts_with("<rect") && line.contains(&format!("height=\"{height}\"")));
    let value = |line: &str, name: &str| {
        line.split(&format!(" {name}=\"")).nth(1).and_then(|rest| rest.split('"').next()).unwrap().to_owned()
    };
    let number = |line: &str, name: &str| value(line, name).parse().unwrap();
    rects.map(|line| ([number(line, "x"), number(line, "y")], number(line, "width"), value(line, "fill"))).collect()
}

/// The texts of an SVG in drawing order.
fn texts(svg: &str) -> Vec<&str> {
    let lines = svg.lines().filter(|line| line.starts_with("<text"));
    lines.filter_map(|line| line.split('>').nth(1)?.split('<').next()).collect()
}

#[test]
fn heat_map_cells_have_the_color_of_their_rate() {
    // Rows of 36 pixels. Viridis goes from #440154 for 0 to #fde725 for 1; a row of zeros is one rectangle.
    let svg = map_of(&two_passes());
    let cells = cells(&svg, "36");
    let [first, second, below] = &cells[..] else { panic!("{cells:?}") };
    assert_eq!((first.2.as_str(), second.2.as_str(), below.2.as_str()), ("#440154", "#fde725", "#440154"));
    let left = first.0[0];
    assert_eq!((second.0, first.1, second.1), ([left + 260, first.0[1]], 260, 260));
    // The next split starts 10 pixels below.
    assert_eq!((below.0, below.1), ([left, first.0[1] + 46], 520));
}

#[test]
fn heat_map_labels_rows_and_axes() {
    let svg = map_of(&two_passes());
    let texts = texts(&svg);
    for label in [
        "What &amp; where",
        "of &lt; a run &gt;",
        "train",
        "test",
        "2 blocks",
        "16 blocks",
        "2_000",
        "test_16_000",
        "environment steps (thousands)",
        "0",
        "40",
        "success (%)",
        "100",
    ] {
        assert!(texts.contains(&label), "no {label:?} in {texts:?}");
    }
    assert!(!texts.contains(&"not evaluated"));
}

#[test]
fn missing_evaluations_are_gray_and_labeled() {
    let mut passes = two_passes();
    passes[0].blueprints.truncate(1);
    let svg = map_of(&passes);
    assert_eq!(cells(&svg, "36")[2].2, "#cccccc");
    assert!(texts(&svg).contains(&"not evaluated"));
}

#[test]
fn single_evaluation_is_labeled_with_its_step() {
    let svg = map_of(&[pass(1_234, &[("2_000", Split::Train, 2, 10)])]);
    assert_eq!(cells(&svg, "36").len(), 1);
    assert!(texts(&svg).contains(&"1234"), "{:?}", texts(&svg));
}

#[test]
fn difference_map_is_blue_if_the_first_run_is_better() {
    let run =
        [pass(0, &[("2_000", Split::Train, 2, 10), ("3_000", Split::Train, 3, 0), ("4_000", Split::Train, 4, 5)])];
    let other =
        [pass(0, &[("2_000", Split::Train, 2, 0), ("3_000", Split::Train, 3, 10), ("4_000", Split::Train, 4, 5)])];
    let difference = Difference::new(&lineage(&run), &lineage(&other), ActionMode::Greedy).unwrap();
    let svg = difference_map(&difference, "", "").to_svg();
    let fills: Vec<String> = cells(&svg, "36").into_iter().map(|(_, _, fill)| fill).collect();
    assert_eq!(fills, ["#053061", "#67001f", "#f7f7f7"]);
    let texts = texts(&svg);
    assert!(["+100", "0", "-100"].iter().all(|label| texts.contains(label)), "{texts:?}");
}

#[test]
fn curves_are_labeled_and_placed_by_rate() {
    let passes = two_passes();
    let svg = curves(&lineage(&passes), ActionMode::Greedy, "", "").unwrap().to_svg();
    let texts = texts(&svg);
    for label in
        ["train 2-6", "test 12-16", "1 blueprint, last 100.0 %", "environment steps (thousands)", "success (%)"]
    {
        assert!(texts.contains(&label), "no {label:?} in {texts:?}");
    }
    // The plot area goes from y = 104 for 100 % to 564 for 0 %.
    let line = svg.lines().find(|line| line.contains("polyline") && line.contains("#0072b2")).unwrap();
    assert!(line.contains("points=\"124.0,564.0 920.0,104.0\""), "{line}");
    // 10 of 10: the interval's lower end is 10 / (10 + z²) = 0.72247, at 564 − 460 × 0.72247 = 231.7.
    let band = svg.lines().find(|line| line.contains("polygon") && line.contains("#0072b2")).unwrap();
    assert!(band.contains(" 920.0,104.0 920.0,231.7 "), "{band}");
    assert!(curves(&lineage(&passes), ActionMode::Sampled, "", "").is_none());
    // A bar instead of a band.
    let once = curves(&lineage(&passes[1..]), ActionMode::Greedy, "", "").unwrap().to_svg();
    assert!(!once.contains("fill-opacity=\"0.180\""));
}

#[test]
fn comparison_labels_each_run() {
    let (run, other) = (two_passes(), vec![pass(20_000, &[("2_000", Split::Train, 2, 5)])]);
    let runs = [("mine".to_owned(), lineage(&run)), ("theirs".to_owned(), lineage(&other))];
    let svg = comparison(&runs, ActionMode::Greedy, "", "").unwrap().to_svg();
    let texts = texts(&svg);
    for label in ["mine", "theirs", "1 blueprint, last 100.0 %", "1 blueprint, last 50.0 %"] {
        assert!(texts.contains(&label), "no {label:?} in {texts:?}");
    }
    assert!(comparison(&runs, ActionMode::Sampled, "", "").is_none());
}

#[test]
fn svg_and_png_agree() {
    let grid = Grid::success(&lineage(&two_passes()), ActionMode::Greedy).unwrap();
    let drawing = success_map(&grid, "title", "");
    let [[x, y], ..] = cells(&drawing.to_svg(), "36")[1..].iter().map(|cell| cell.0).collect::<Vec<_>>()[..] else {
        panic!("no cells")
    };
    let image = raster::paint(&drawing);
    assert_eq!(image.get(x as usize, y as usize), Some([253, 231, 37]));
    assert_eq!(drawing.to_png().unwrap()[..8], *b"\x89PNG\r\n\x1a\n");
}

#[test]
fn group_table_matches_hand_worked_values() {
    let pass = pass(9, &[("2_000", Split::Train, 2, 4), ("3_000", Split::Train, 3, 0)]);
    let rows = groups::rows(&pass);
    // 4 of 20; 2 stable; no steps from the blueprint without success; returns of 1.27 each; 1 and 2 diverged. Wilson:
    // (0.2 + 0.09604) / 1.19207 = 0.2483 ± 1.95996 / 1.19207 × √(0.16 / 20 + 0.0024010) = 0.1677.
    let markdown = groups::markdown(&rows);
    let expected = "| train 2-6 | 2 | greedy | 20 | 20.0 % | 8.1 to 41.6 | 10.0 % | 21.3 | 1.27 | 3 |";
    assert!(markdown.lines().any(|line| line == expected), "{markdown}");
    let csv = groups::csv(&rows);
    let lines: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(lines.iter().map(Vec::len).collect::<Vec<_>>(), [12, 12, 12]);
    assert_eq!(lines[1][..6], ["train 2-6", "2", "greedy", "20", "4", "0.2"]);
    assert_eq!((lines[2][0], lines[2][4]), ("all", "4"));
}
