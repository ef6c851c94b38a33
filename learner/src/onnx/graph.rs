//! ONNX's file format: the few messages of `onnx.proto` that a graph of tensors needs, written field by field.

/// Version of the file format, and of the operators: the first with LayerNormalization.
const IR_VERSION: i64 = 8;
const OPERATORS: i64 = 17;

/// Type of a tensor's elements.
#[derive(Clone, Copy)]
pub(super) enum Type {
    Float = 1,
    Int64 = 7,
    Bool = 9,
}

/// A graph under construction: the fields of a GraphProto.
#[derive(Default)]
pub(super) struct Graph {
    fields: Message,
    n_constants: usize,
}

/// Fields of a protobuf message.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn varint(&mut self, mut number: u64) {
        while number >= 0x80 {
            self.0.push(number as u8 | 0x80);
            number >>= 7;
        }
        self.0.push(number as u8);
    }

    fn int(mut self, field: u64, number: i64) -> Self {
        self.varint(field << 3);
        self.varint(number as u64);
        self
    }

    fn bytes(mut self, field: u64, bytes: &[u8]) -> Self {
        self.varint(field << 3 | 2);
        self.varint(bytes.len() as u64);
        self.0.extend(bytes);
        self
    }

    fn text(self, field: u64, text: &str) -> Self {
        self.bytes(field, text.as_bytes())
    }
}

impl Graph {
    /// Adds operators, one a line: `result = Operator argument … attribute:value …`.
    ///
    /// An argument is a tensor's name, a number, or a list of whole numbers. A name with a dot in front belongs to `at`.
    /// The operator `Linear` is a product with a kernel plus a bias.
    pub(super) fn add(&mut self, at: &str, lines: &str) {
        for line in lines.lines() {
            let mut words = line.split_whitespace().filter(|word| *word != "=");
            let Some((result, operator)) = words.next().zip(words.next()) else { continue };
            let result = full(at, result);
            let (attributes, arguments): (Vec<&str>, Vec<&str>) = words.partition(|word| word.contains(':'));
            let arguments: Vec<String> = arguments.into_iter().map(|word| self.argument(at, word)).collect();
            if let ("Linear", [x, layer]) = (operator, &arguments[..]) {
                let product = format!("{result}.product");
                self.operator("MatMul", &product, &[x.clone(), format!("{layer}.w")], &[]);
                self.operator("Add", &result, &[product, format!("{layer}.b")], &[]);
            } else {
                self.operator(operator, &result, &arguments, &attributes);
            }
        }
    }

    fn operator(&mut self, operator: &str, result: &str, arguments: &[String], attributes: &[&str]) {
        let node = arguments.iter().fold(Message::default(), |node, name| node.text(1, name));
        let node = attributes.iter().filter_map(|word| word.split_once(':')).fold(node, |node, (name, value)| {
            let attribute = Message::default().text(1, name);
            let attribute = match value.parse() {
                Ok(number) => attribute.int(3, number).int(20, 2),
                Err(_) => attribute.text(4, value).int(20, 3),
            };
            node.bytes(5, &attribute.0)
        });
        self.field(1, &node.text(2, result).text(4, operator));
    }

    /// Returns the name of an argument, after adding it if it is a number or a list.
    fn argument(&mut self, at: &str, word: &str) -> String {
        let name = format!("constant.{}", self.n_constants);
        self.n_constants += 1;
        if let Some(list) = word.strip_prefix('[').and_then(|word| word.strip_suffix(']')) {
            let numbers: Vec<i64> = list.split(',').filter_map(|number| number.parse().ok()).collect();
            self.tensor(&name, &[numbers.len()], Type::Int64, numbers.iter().map(|x| x.to_le_bytes()));
        } else if let Ok(number) = word.parse::<f32>() {
            self.tensor(&name, &[], Type::Float, [number.to_le_bytes()]);
        } else {
            return full(at, word);
        }
        name
    }

    pub(super) fn tensor<const N: usize>(
        &mut self,
        name: &str,
        shape: &[usize],
        of: Type,
        values: impl IntoIterator<Item = [u8; N]>,
    ) {
        let tensor = shape.iter().fold(Message::default(), |tensor, n| tensor.int(1, *n as i64));
        let bytes: Vec<u8> = values.into_iter().flatten().collect();
        self.field(5, &tensor.int(2, of as i64).text(8, name).bytes(9, &bytes));
    }

    /// Names an input for a batch; `shape` is that of one scene.
    pub(super) fn input(&mut self, name: &str, of: Type, shape: &[usize]) {
        self.field(11, &about(name, of, shape));
    }

    /// Makes a result an output.
    pub(super) fn output(&mut self, name: &str, shape: &[usize]) {
        self.field(12, &about(name, Type::Float, shape));
    }

    fn field(&mut self, field: u64, message: &Message) {
        self.fields = std::mem::take(&mut self.fields).bytes(field, &message.0);
    }

    pub(super) fn into_bytes(self) -> Vec<u8> {
        let graph = self.fields.text(2, "policy");
        let operators = Message::default().text(1, "").int(2, OPERATORS);
        let model = Message::default().int(1, IR_VERSION).text(2, "lodestone");
        model.bytes(7, &graph.0).bytes(8, &operators.0).0
    }
}

fn full(at: &str, name: &str) -> String {
    if name.starts_with('.') { format!("{at}{name}") } else { name.to_owned() }
}

/// Describes an input or an output.
fn about(name: &str, of: Type, shape: &[usize]) -> Message {
    let batch = Message::default().bytes(1, &Message::default().text(2, "batch").0);
    let shape = shape.iter().fold(batch, |m, n| m.bytes(1, &Message::default().int(1, *n as i64).0));
    let tensor = Message::default().int(1, of as i64).bytes(2, &shape.0);
    Message::default().text(1, name).bytes(2, &Message::default().bytes(1, &tensor.0).0)
}
