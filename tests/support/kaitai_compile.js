// Compile specifications of Kaitai Struct: for each line [LANGUAGE, SPECIFICATION] of standard input a line with the files.
const compiler = require("kaitai-struct-compiler");
const readline = require("readline");

readline.createInterface({ input: process.stdin }).on("line", (line) => {
    const [language, specification] = JSON.parse(line);
    compiler
        .compile(language, specification, null, false)
        .then((files) => ({ files }))
        .catch((error) => ({ error: String(error) }))
        .then((answer) => console.log(JSON.stringify(answer)));
});
