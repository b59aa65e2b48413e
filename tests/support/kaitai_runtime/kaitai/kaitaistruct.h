/* The base of compiled classes, and the one error that compiled code throws; see kaitaistream.h. */
#ifndef KAITAI_STRUCT_H
#define KAITAI_STRUCT_H

#include "kaitai/kaitaistream.h"

namespace kaitai {

class kstruct {
public:
    explicit kstruct(kstream *io) : m__io(io) {}
    virtual ~kstruct() {}
    kstream *_io() const { return m__io; }

protected:
    kstream *m__io;
};

}  // namespace kaitai

#endif
