"""Prints what a JSON Schema finds wrong with configuration files, as JSON: {file: [messages]}.

Usage: python schema.py SCHEMA FILE...
"""

import json
import pathlib
import sys
import tomllib

import jsonschema

schema = json.loads(pathlib.Path(sys.argv[1]).read_text())
jsonschema.Draft202012Validator.check_schema(schema)
validator = jsonschema.Draft202012Validator(schema)
files = {file: tomllib.loads(pathlib.Path(file).read_text()) for file in sys.argv[2:]}
print(json.dumps({file: [error.message for error in validator.iter_errors(config)] for file, config in files.items()}))
