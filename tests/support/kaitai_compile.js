// Compile a specification of Kaitai Struct, as JSON on standard input: node kaitai_compile.js LANGUAGE FOLDER
const compiler = require("kaitai-struct-compiler");
const fs = require("fs");
const path = require("path");

const [language, folder] = process.argv.slice(2);
compiler
    .compile(language, JSON.parse(fs.readFileSync(0, "utf8")), null, false)
    .then((files) => {
        for (const [name, text] of Object.entries(files)) {
            fs.writeFileSync(path.join(folder, name), text);
        }
    })
    .catch((error) => {
        console.error(String(error));
        process.exit(1);
    });
