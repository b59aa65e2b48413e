/* Calls one of several functions that were built for different types of arguments.
 *
 * The types are spelt as a key of bytes, which is the same in every process: a letter for a number; dimensions, layout,
 * flags and element of an array; the class of a named tuple and its items. Structured elements and classes are spelt by
 * the function that `use_names` sets, once for each.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <structmember.h>
#define NPY_NO_DEPRECATED_API NPY_1_22_API_VERSION
#include <numpy/arrayobject.h>
#include <numpy/arrayscalars.h>

enum { KEY_BYTES = 4096 };

typedef struct {
    char bytes[KEY_BYTES];
    Py_ssize_t size;
} Key;

/* What functions that spell return: the key is complete; an exception is set; nothing is built for such a value. */
enum { SPELT = 0, RAISED = -1, UNKNOWN = 1 };

static PyObject *known_names; /* dict: dtype or class to bytes */
static PyObject *name_of;     /* from dtype or class to bytes */

static int
add(Key *key, const char *bytes, Py_ssize_t size)
{
    if (key->size + size > KEY_BYTES) {
        return UNKNOWN;
    }
    memcpy(key->bytes + key->size, bytes, (size_t)size);
    key->size += size;
    return SPELT;
}

static int
add_name(Key *key, PyObject *object)
{
    PyObject *name = PyDict_GetItemWithError(known_names, object);
    if (name == NULL) {
        if (PyErr_Occurred()) {
            return RAISED;
        }
        name = PyObject_CallOneArg(name_of, object);
        if (name == NULL || PyDict_SetItem(known_names, object, name) < 0) {
            Py_XDECREF(name);
            return RAISED;
        }
        Py_DECREF(name); /* the dictionary keeps it */
    }
    if (!PyBytes_Check(name)) {
        PyErr_SetString(PyExc_TypeError, "names are bytes");
        return RAISED;
    }
    return add(key, PyBytes_AS_STRING(name), PyBytes_GET_SIZE(name));
}

static int
add_element(Key *key, PyArray_Descr *element)
{
    if (PyTypeNum_ISNUMBER(element->type_num) || PyTypeNum_ISBOOL(element->type_num)) {
        const char spelt[2] = {element->type, PyArray_ISNBO(element->byteorder) ? '=' : '!'};
        return add(key, spelt, sizeof spelt);
    }
    return add_name(key, (PyObject *)element);
}

static int
add_array(Key *key, PyArrayObject *array)
{
    const int flags = PyArray_FLAGS(array);
    const char layout = flags & NPY_ARRAY_C_CONTIGUOUS ? 'C' : flags & NPY_ARRAY_F_CONTIGUOUS ? 'F' : 'A';
    const char spelt[5] = {
        'a', (char)('0' + PyArray_NDIM(array)), layout, flags & NPY_ARRAY_WRITEABLE ? 'w' : 'r',
        flags & NPY_ARRAY_ALIGNED ? 'a' : 'u',
    };
    const int status = add(key, spelt, sizeof spelt);
    return status == SPELT ? add_element(key, PyArray_DESCR(array)) : status;
}

static int
add_int(Key *key, PyObject *value)
{
    int overflow;
    PyLong_AsLongLongAndOverflow(value, &overflow);
    return overflow ? UNKNOWN : add(key, "i", 1);
}

static int add_value(Key *key, PyObject *value);

static int
add_tuple(Key *key, PyObject *tuple)
{
    const int is_named = !PyTuple_CheckExact(tuple);
    int status = add(key, is_named ? "{" : "(", 1);
    if (status == SPELT && is_named) {
        status = add_name(key, (PyObject *)Py_TYPE(tuple));
    }
    for (Py_ssize_t k = 0; status == SPELT && k < PyTuple_GET_SIZE(tuple); k++) {
        status = add_value(key, PyTuple_GET_ITEM(tuple, k));
    }
    return status == SPELT ? add(key, ")", 1) : status;
}

/* A scalar of numpy that a number of Python equals in type is spelt as that is. */
static int
add_scalar(Key *key, PyObject *scalar)
{
    PyArray_Descr *element = PyArray_DescrFromScalar(scalar);
    if (element == NULL) {
        return RAISED;
    }
    const int type = element->type_num;
    int status;
    if (type == NPY_DOUBLE || type == NPY_LONG || type == NPY_BOOL) {
        status = add(key, type == NPY_DOUBLE ? "f" : type == NPY_LONG ? "i" : "b", 1);
    } else {
        status = add(key, "s", 1);
        if (status == SPELT) {
            status = add_element(key, element);
        }
    }
    Py_DECREF(element);
    return status;
}

static int
add_value(Key *key, PyObject *value)
{
    if (PyArray_CheckExact(value)) {
        return add_array(key, (PyArrayObject *)value);
    }
    if (PyFloat_CheckExact(value)) {
        return add(key, "f", 1);
    }
    if (PyLong_CheckExact(value)) {
        return add_int(key, value);
    }
    if (PyTuple_Check(value)) {
        return add_tuple(key, value);
    }
    if (PyBool_Check(value)) {
        return add(key, "b", 1);
    }
    if (PyArray_CheckScalar(value)) {
        return add_scalar(key, value);
    }
    return value == Py_None ? add(key, "n", 1) : UNKNOWN;
}

static int
spell(Key *key, PyObject *const *values, Py_ssize_t count)
{
    int status = SPELT;
    key->size = 0;
    for (Py_ssize_t k = 0; status == SPELT && k < count; k++) {
        status = add_value(key, values[k]);
    }
    return status;
}

typedef struct {
    PyObject_HEAD
    vectorcallfunc vectorcall;
    PyObject *built;     /* tuple of (key, function) */
    PyObject *otherwise; /* called with arguments of other types */
} Overloads;

static PyObject *
overloads_call(PyObject *self, PyObject *const *arguments, size_t flagged_count, PyObject *names)
{
    Overloads *overloads = (Overloads *)self;
    PyObject *chosen = overloads->otherwise;
    Key key;
    const int has_names = names != NULL && PyTuple_GET_SIZE(names) > 0;
    const int status = has_names ? UNKNOWN : spell(&key, arguments, PyVectorcall_NARGS(flagged_count));
    if (status == RAISED) {
        return NULL;
    }
    for (Py_ssize_t k = 0; status == SPELT && k < PyTuple_GET_SIZE(overloads->built); k++) {
        PyObject *pair = PyTuple_GET_ITEM(overloads->built, k);
        PyObject *expected = PyTuple_GET_ITEM(pair, 0);
        if (PyBytes_GET_SIZE(expected) == key.size &&
            memcmp(PyBytes_AS_STRING(expected), key.bytes, (size_t)key.size) == 0) {
            chosen = PyTuple_GET_ITEM(pair, 1);
            break;
        }
    }
    return PyObject_Vectorcall(chosen, arguments, flagged_count, names);
}

static PyObject *
overloads_new(PyTypeObject *type, PyObject *arguments, PyObject *named)
{
    PyObject *built, *otherwise;
    static char *keywords[] = {"built", "otherwise", NULL};
    if (!PyArg_ParseTupleAndKeywords(arguments, named, "O!O", keywords, &PyTuple_Type, &built, &otherwise)) {
        return NULL;
    }
    for (Py_ssize_t k = 0; k < PyTuple_GET_SIZE(built); k++) {
        PyObject *pair = PyTuple_GET_ITEM(built, k);
        if (!PyTuple_Check(pair) || PyTuple_GET_SIZE(pair) != 2 || !PyBytes_Check(PyTuple_GET_ITEM(pair, 0))) {
            PyErr_SetString(PyExc_TypeError, "built holds pairs of a key and a function");
            return NULL;
        }
    }
    Overloads *self = (Overloads *)type->tp_alloc(type, 0);
    if (self != NULL) {
        self->vectorcall = overloads_call;
        self->built = Py_NewRef(built);
        self->otherwise = Py_NewRef(otherwise);
    }
    return (PyObject *)self;
}

static void
overloads_dealloc(PyObject *self)
{
    Py_DECREF(((Overloads *)self)->built);
    Py_DECREF(((Overloads *)self)->otherwise);
    Py_TYPE(self)->tp_free(self);
}

static PyMemberDef overloads_members[] = {
    {"__vectorcalloffset__", T_PYSSIZET, offsetof(Overloads, vectorcall), READONLY, NULL},
    {NULL},
};

static PyTypeObject OverloadsType = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "overloads.Overloads",
    .tp_doc = "Calls the function built for the types of the arguments, else `otherwise`.",
    .tp_basicsize = sizeof(Overloads),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_VECTORCALL,
    .tp_vectorcall_offset = offsetof(Overloads, vectorcall),
    .tp_call = PyVectorcall_Call,
    .tp_new = overloads_new,
    .tp_dealloc = overloads_dealloc,
    .tp_members = overloads_members,
};

static PyObject *
key_of(PyObject *Py_UNUSED(module), PyObject *const *arguments, Py_ssize_t count)
{
    Key key;
    switch (spell(&key, arguments, count)) {
    case SPELT:
        return PyBytes_FromStringAndSize(key.bytes, key.size);
    case UNKNOWN:
        Py_RETURN_NONE;
    default:
        return NULL;
    }
}

static PyObject *
use_names(PyObject *Py_UNUSED(module), PyObject *function)
{
    PyDict_Clear(known_names);
    Py_XSETREF(name_of, Py_NewRef(function));
    Py_RETURN_NONE;
}

static PyMethodDef functions[] = {
    {"key_of", (PyCFunction)(void (*)(void))key_of, METH_FASTCALL, "Key of the types of the arguments; None if nothing can be built for them."},
    {"use_names", use_names, METH_O, "Set the function from a dtype or a class to its name, bytes."},
    {NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "overloads", .m_size = -1, .m_methods = functions,
};

PyMODINIT_FUNC
PyInit_overloads(void)
{
    import_array();
    known_names = PyDict_New();
    PyObject *module = PyModule_Create(&definition);
    if (known_names == NULL || module == NULL || PyModule_AddType(module, &OverloadsType) < 0) {
        return NULL;
    }
    return module;
}
