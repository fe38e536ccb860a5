/* FMI 2.0 for co-simulation over the kernels of the engine, compiled ahead of time.

   All of an instance lies in one buffer [header | parameters | inputs | outputs | constants | state
   | work] (kernels/layout.py); the value reference of a variable is its place from the parameters
   on. Nothing that changes lies outside of an instance: instances may run in threads of their own.
   Memory is taken when an instance is made, when fixed parameters change the size of its state,
   and for saved states; never in a step. Names, texts, limits and offsets are in screen.h. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "screen.h"

#define COUNT(array) ((int) (sizeof(array) / sizeof((array)[0])))
#define DEGREE 0.017453292519943295

/* A buffer, where its sections lie, and the parameters that it was laid out for. */
typedef struct {
    double *buffer, *built_with;
    Sections at;
} Laid;

typedef struct {
    Laid laid;
    char *name;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    int logging, running, ended;
    double time;
} Screen;

/* A saved state: what an instance must remember, from the parameters to the end of the state. */
typedef struct {
    int64_t running, count;
    double time, body[];
} State;

/* What goes before the body when a state is written. */
typedef struct {
    char mark[8];
    unsigned char owner[16];
    uint64_t running, checksum;
} Head;

/* What the braces of a text stand for. */
typedef struct {
    const char *name, *unit, *cure, *kind, *other;
    double value, limit, other_limit, number;
} Told;

/* --- messages --------------------------------------------------------------------------------- */
typedef struct {
    char text[1024];
    size_t used;
} Message;

static void add(Message *message, const char *text, size_t length) {
    size_t room = sizeof message->text - 1 - message->used;
    length = length < room ? length : room;
    memcpy(message->text + message->used, text, length);
    message->used += length;
    message->text[message->used] = 0;
}

static void add_text(Message *message, const char *text) { add(message, text ? text : "", text ? strlen(text) : 0); }

static void add_number(Message *message, double value, int digits) {
    char text[40];
    if (value != value) add_text(message, "nan");
    else if (fabs(value) > 1e308 * 1.7976931348623157) add_text(message, value > 0 ? "inf" : "-inf");
    else {
        snprintf(text, sizeof text, "%.*g", digits, value);
        /* Numbers do not follow the locale of the host: what is no digit, sign or e is its point. */
        const char *known = "0123456789+-e";
        char *point = text + strspn(text, known), *rest = point + strcspn(point, known);
        add(message, text, (size_t) (point - text));
        if (rest > point) add_text(message, ".");
        add_text(message, rest);
    }
}

static void add_with_unit(Message *message, double value, const char *unit) {
    add_number(message, value, 6);
    if (unit && *unit && strcmp(unit, "1")) {
        add_text(message, " ");
        add_text(message, unit);
    }
}

/* Whether what stands in the braces is this word. */
static int is(const char *place, size_t length, const char *word) {
    return strlen(word) == length && !memcmp(place, word, length);
}

static double number_named(const char *key, size_t n, const Told *told) {
    if (is(key, n, "value")) return told->value;
    if (is(key, n, "limit")) return told->limit;
    if (is(key, n, "other_limit")) return told->other_limit;
    if (is(key, n, "degrees")) return told->value / DEGREE;
    if (is(key, n, "slope")) return tan(told->value);
    return told->number;
}

static const char *text_named(const char *key, size_t n, const Told *told) {
    if (is(key, n, "name")) return told->name;
    if (is(key, n, "cure")) return told->cure;
    if (is(key, n, "kind")) return told->kind;
    return told->other;
}

/* Write a text of the table as Python's str.format would. */
static void tell(Message *message, const char *text, const Told *told) {
    while (*text) {
        size_t plain = strcspn(text, "{");
        add(message, text, plain);
        text += plain;
        if (!*text) return;
        const char *key = text + 1;
        size_t n = strcspn(key, ":}");
        if (key[n] == ':') add_number(message, number_named(key, n, told), atoi(key + n + 2));
        else if (is(key, n, "given")) {
            add_text(message, told->name);
            add_text(message, " = ");
            add_with_unit(message, told->value, told->unit);
        } else if (is(key, n, "bound")) add_with_unit(message, told->limit, told->unit);
        else add_text(message, text_named(key, n, told));
        text = key + strcspn(key, "}") + 1;
    }
}

static fmi2Status refuse(const Screen *screen, int text, Told told) {
    if (screen->logging && screen->logger) {
        Message message = {.used = 0};
        tell(&message, TEXT[text], &told);
        /* A host takes the message for a format; some show it as it is. Both get what was meant. */
        const char *format = strchr(message.text, '%') ? "%s" : message.text;
        screen->logger(screen->environment, screen->name, fmi2Error, "logStatusError", format, message.text);
    }
    return fmi2Error;
}

/* --- the engine ------------------------------------------------------------------------------- */
/* Carry out a command; tells what the kernels refuse. */
static fmi2Status run(const Screen *screen, Laid *laid, int command, double first) {
    double *buffer = laid->buffer;
    int64_t code = vibroscreen_run(buffer, laid->at.size, command, first, 0);
    if (code < 0 || code > LAST_CODE)
        return refuse(screen, TEXT_FAILED, (Told) {.value = (double) code});
    if (code == ACCEPTED) return fmi2OK;
    const double *refusal = buffer + (int64_t) buffer[AT_REFUSAL];
    int64_t place = (int64_t) refusal[1];
    const Variable *variable = VARIABLE + (place - PARAMETERS);
    double limit = refusal[3] < 0 && refusal[3] > -1e-6 ? 0.0 : refusal[3];
    Told told = {
        .name = variable->name, .unit = variable->unit, .cure = variable->cure,
        .value = refusal[2], .limit = limit, .number = buffer[place],
    };
    return refuse(screen, TEXT_OF_CODE[code], told);
}

/* Outputs that are found only when they are read. */
static void read_outputs(Screen *screen) {
    const double *buffer = screen->laid.buffer;
    if (buffer[(int64_t) buffer[AT_MEMORY] + M_UNREAD] > 0)
        run(screen, &screen->laid, COMMAND_READ, 0);
}

static int breaks(int text, double value, double limit) {
    if (text == TEXT_ENDLESS) return !isfinite(value);
    if (text == TEXT_NOT_ABOVE) return value <= limit;
    if (text == TEXT_BELOW) return value < limit;
    return text == TEXT_NOT_BELOW ? value >= limit : value > limit;
}

static fmi2Status check_limits(const Screen *screen, const double *p, const double *header) {
    int64_t classes = (int64_t) DIMENSIONS[D_CLASSES];
    const double *lower = p + (int64_t) header[AT_LOWER] - PARAMETERS;
    const double *upper = p + (int64_t) header[AT_UPPER] - PARAMETERS;
    for (const Choice *c = CHOICE; c < CHOICE + COUNT(CHOICE); c++)
        if (!(p[c->reference] >= 1 && p[c->reference] <= c->most) && p[c->reference] != START[c->reference])
            return refuse(screen, TEXT_NO_CHOICE, (Told) {.name = c->name, .cure = c->cure, .value = p[c->reference]});
    for (int64_t i = 0; i + 1 < classes; i++)
        if (upper[i] != lower[i + 1]) {
            const char *name = VARIABLE[upper + i - p].name;
            return refuse(screen, TEXT_TWO_LIMITS, (Told) {.name = name, .value = upper[i], .limit = lower[i + 1]});
        }
    for (const Limit *l = LIMIT; l < LIMIT + COUNT(LIMIT); l++)
        if (breaks(l->text, p[l->reference], l->limit)) {
            Told told = {.name = l->name, .unit = l->unit, .cure = l->cure, .value = p[l->reference], .limit = l->limit};
            return refuse(screen, l->text, told);
        }
    for (int64_t i = 0; i < classes; i++)
        if (upper[i] <= lower[i]) {
            char name[40], other[40];
            snprintf(name, sizeof name, "size_classes.edges[%d]", (int) i + 2);
            snprintf(other, sizeof other, "edges[%d]", (int) i + 1);
            Told told = {.name = name, .other = other, .value = upper[i], .limit = lower[i]};
            return refuse(screen, TEXT_NOT_ASCENDING, told);
        }
    return fmi2OK;
}

static fmi2Status check_decks(const Screen *screen, const double *p, const double *header) {
    const double *panel = p + (int64_t) header[AT_PANEL] - PARAMETERS;
    const double *count = START + (int64_t) header[AT_PANEL_COUNT] - PARAMETERS;
    int64_t decks = (int64_t) DIMENSIONS[D_DECKS], panels = (int64_t) DIMENSIONS[D_PANELS];
    double first = 0;
    for (int64_t d = 0; d < decks; d++) {
        const double *row = panel + d * panels * PANEL_SIZE;
        double length = 0;
        for (int64_t k = 0; k < (int64_t) count[d]; k++) length += row[k * PANEL_SIZE + PANEL_LENGTH];
        for (int64_t k = 0; k < (int64_t) count[d]; k++) {
            const double *aperture = row + k * PANEL_SIZE + PANEL_APERTURE;
            Told told = {.name = VARIABLE[aperture - p].name, .value = *aperture, .limit = length};
            if (*aperture > length) return refuse(screen, TEXT_SHORT_DECK, told);
            told.limit = TABLE_APERTURE[0], told.other_limit = TABLE_APERTURE[COUNT(TABLE_APERTURE) - 1];
            if (TABLE_ROWS && (*aperture < told.limit || *aperture > told.other_limit))
                return refuse(screen, TEXT_OFF_TABLE, told);
        }
        first = d == 0 ? length : first;
        if (fabs(length - first) > 1e-9 * fmax(length, first)) {
            char name[24];
            snprintf(name, sizeof name, "deck[%d]", (int) d + 1);
            return refuse(screen, TEXT_UNEQUAL_DECKS, (Told) {.name = name, .value = length, .limit = first});
        }
    }
    return fmi2OK;
}

/* A zeroed buffer with room for the dimensions in its header, and for the parameters behind it. */
static fmi2Status make_buffer(const Screen *screen, const double *dimensions, Laid *made) {
    double header[HEADER];
    memcpy(header, dimensions, N_DIMENSIONS * sizeof(double));
    made->at = lay_out(header);
    size_t parameters = (size_t) (made->at.inputs - PARAMETERS), whole = (size_t) made->at.size + parameters;
    made->buffer = calloc(whole, sizeof(double));
    if (!made->buffer) return refuse(screen, TEXT_NO_ROOM, (Told) {.value = 8.0 * (double) whole});
    made->built_with = made->buffer + made->at.size;
    memcpy(made->buffer, header, sizeof header);
    return fmi2OK;
}

/* Fill in a slice of the bed for these fixed parameters, and what follows from them. */
static fmi2Status plan_slice(const Screen *screen, const double *parameters, Laid *slice) {
    double dimensions[N_DIMENSIONS];
    memcpy(dimensions, DIMENSIONS, sizeof dimensions);
    double model = parameters[P_SEGREGATION_MODEL];
    int layered = model == EXCHANGE || (model == START[P_SEGREGATION_MODEL] && OWN_SEGREGATION_LAYERED);
    dimensions[D_LAYERED] = layered;
    dimensions[D_LAYERS] = layered ? DIMENSIONS[D_BED_LAYERS] : 1;
    if (make_buffer(screen, dimensions, slice) != fmi2OK) return fmi2Error;
    double *buffer = slice->buffer;
    memcpy(buffer + PARAMETERS, START, sizeof START);
    for (int k = 0; k < COUNT(FIXED_ONES); k++)
        buffer[PARAMETERS + FIXED_ONES[k]] = parameters[FIXED_ONES[k]];
    if (check_limits(screen, buffer + PARAMETERS, buffer) != fmi2OK) return fmi2Error;
    if (check_decks(screen, buffer + PARAMETERS, buffer) != fmi2OK) return fmi2Error;
    int64_t classes = (int64_t) DIMENSIONS[D_CLASSES];
    double *edge = buffer + (int64_t) buffer[AT_EDGE];
    memcpy(edge, buffer + (int64_t) buffer[AT_LOWER], (size_t) classes * sizeof(double));
    edge[classes] = buffer[(int64_t) buffer[AT_UPPER] + classes - 1];
    vibroscreen_plan(buffer, slice->at.size, (double *) TABLE_APERTURE, TABLE_ROWS, (double *) TABLE_VELOCITY, TABLE_ROWS);
    double cells = buffer[D_CELLS];
    if (ROOM > 0 && ROOM < cells + 4)
        return refuse(screen, TEXT_LITTLE_ROOM, (Told) {.value = ROOM, .limit = cells, .other_limit = cells + 4});
    return fmi2OK;
}

/* Lay out a screen of these parameters: constants are filled in, inputs are those of the start. */
static fmi2Status lay(const Screen *screen, const double *parameters, Laid *made) {
    Laid slice = {.buffer = NULL};
    made->buffer = NULL;
    fmi2Status status = plan_slice(screen, parameters, &slice);
    if (status == fmi2OK) {
        double dimensions[N_DIMENSIONS];
        memcpy(dimensions, slice.buffer, sizeof dimensions);
        dimensions[D_PACKAGES] = ROOM > 0 ? ROOM : 4 * dimensions[D_CELLS] + 16;
        dimensions[D_FALLS] = DIMENSIONS[D_DECKS] > 1 ? dimensions[D_PACKAGES] : 1;
        dimensions[D_ACTIVE] = dimensions[D_NODES];
#ifdef OWN_DISPLACEMENT
        dimensions[D_DISPLACEMENT_ADDRESS] = (double) (uintptr_t) OWN_DISPLACEMENT;
#endif
#ifdef OWN_PASSAGE
        dimensions[D_PASSAGE_ADDRESS] = (double) (uintptr_t) OWN_PASSAGE;
#endif
#ifdef OWN_SEGREGATION
        dimensions[D_SEGREGATION_ADDRESS] = (double) (uintptr_t) OWN_SEGREGATION;
#endif
        status = make_buffer(screen, dimensions, made);
    }
    if (status == fmi2OK) {
        double *buffer = made->buffer, *from = slice.buffer;
        for (int field = AT_FIRST + 1; field < AT_FIRST_OF_STATE; field++) {
            double stop = field + 1 < AT_FIRST_OF_STATE ? buffer[field + 1] : (double) made->at.state;
            size_t size = (size_t) (stop - buffer[field]);
            memcpy(buffer + (int64_t) buffer[field], from + (int64_t) from[field], size * sizeof(double));
        }
        for (int k = 0; k < COUNT(TUNABLE_ONES); k++) {
            int reference = TUNABLE_ONES[k];
            if (parameters[reference] != START[reference]) buffer[PARAMETERS + reference] = parameters[reference];
        }
        memcpy(made->built_with, buffer + PARAMETERS, (size_t) (made->at.inputs - PARAMETERS) * sizeof(double));
    }
    free(slice.buffer);
    return status;
}

static int same_fixed(const double *one, const double *two) {
    for (int k = 0; k < COUNT(FIXED_ONES); k++)
        if (one[FIXED_ONES[k]] != two[FIXED_ONES[k]]) return 0;
    return 1;
}

/* Start anew with the parameters and inputs in the buffer. */
static fmi2Status start(const Screen *screen, Laid *laid) {
    double *changing = laid->buffer + laid->at.outputs;
    memset(changing, 0, (size_t) (laid->at.constants - laid->at.outputs) * sizeof(double));
    memset(laid->buffer + laid->at.state, 0, (size_t) (laid->at.work - laid->at.state) * sizeof(double));
    return run(screen, laid, COMMAND_INITIALISE, 0);
}

static fmi2Status start_afresh(Screen *screen) {
    Laid made;
    fmi2Status status = lay(screen, START, &made);
    if (status == fmi2OK) status = start(screen, &made);
    if (status != fmi2OK) {
        free(made.buffer);
        return status;
    }
    free(screen->laid.buffer);
    screen->laid = made;
    screen->running = screen->ended = 0;
    return fmi2OK;
}

/* --- life of an instance ---------------------------------------------------------------------- */
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void) resources, (void) visible;
    if (!functions) return NULL;
    Screen asking = {.name = (char *) (name ? name : ""), .logger = functions->logger,
                     .environment = functions->componentEnvironment, .logging = 1};
    if (!name || !*name || type != fmi2CoSimulation) {
        refuse(&asking, TEXT_NO_INSTANCE, (Told) {.name = "fmi2Instantiate", .other = asking.name});
        return NULL;
    }
    if (!guid || strcmp(guid, GUID)) {
        refuse(&asking, TEXT_OTHER_GUID, (Told) {.name = GUID, .other = guid ? guid : ""});
        return NULL;
    }
    Screen *screen = calloc(1, sizeof *screen);
    char *copy = malloc(strlen(name) + 1);
    if (screen && copy) {
        *screen = asking;
        screen->name = strcpy(copy, name);
        if (start_afresh(screen) == fmi2OK) {
            screen->logging = logging;
            return screen;
        }
    }
    free(screen);
    free(copy);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c) {
    Screen *screen = c;
    if (!screen) return;
    free(screen->laid.buffer);
    free(screen->name);
    free(screen);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    Screen *screen = c;
    if (!screen) return fmi2Error;
    int wanted = n == 0;
    for (size_t k = 0; categories && k < n; k++)
        wanted |= categories[k] && (!strcmp(categories[k], "logStatusError") || !strcmp(categories[k], "logAll"));
    if (wanted) screen->logging = on;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean bounded, fmi2Real tolerance, fmi2Real begin,
                               fmi2Boolean ends, fmi2Real end) {
    Screen *screen = c;
    (void) bounded, (void) tolerance, (void) ends, (void) end;
    if (!screen) return fmi2Error;
    screen->time = begin;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

/* The screen starts with the parameters and inputs set so far; if it cannot, all stays. */
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Screen *screen = c;
    if (!screen) return fmi2Error;
    if (screen->running) return refuse(screen, TEXT_STARTED, (Told) {.value = 0});
    Laid *laid = &screen->laid, made = *laid;
    const double *parameters = laid->buffer + PARAMETERS;
    size_t whole = (size_t) laid->at.size * sizeof(double);
    if (same_fixed(parameters, laid->built_with)) {
        double *kept = malloc(whole);
        if (!kept) return refuse(screen, TEXT_NO_ROOM, (Told) {.value = (double) whole});
        memcpy(kept, laid->buffer, whole);
        fmi2Status status = start(screen, laid);
        if (status != fmi2OK) memcpy(laid->buffer, kept, whole);
        free(kept);
        if (status != fmi2OK) return status;
    } else {
        fmi2Status status = lay(screen, parameters, &made);
        if (status == fmi2OK) {
            size_t inputs = (size_t) (laid->at.outputs - laid->at.inputs) * sizeof(double);
            memcpy(made.buffer + made.at.inputs, laid->buffer + laid->at.inputs, inputs);
            status = start(screen, &made);
        }
        if (status != fmi2OK) {
            free(made.buffer);
            return status;
        }
        free(laid->buffer);
        *laid = made;
    }
    screen->running = 1;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) {
    Screen *screen = c;
    if (!screen) return fmi2Error;
    screen->ended = 1;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) { return c ? start_afresh(c) : fmi2Error; }

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real duration, fmi2Boolean no_way_back) {
    Screen *screen = c;
    (void) no_way_back;
    if (!screen) return fmi2Error;
    if (!screen->running || screen->ended) return refuse(screen, TEXT_NO_STEP, (Told) {.value = 0});
    if (!(duration >= SHORTEST_STEP && duration <= 1.7976931348623157e308)) return refuse(screen, TEXT_NO_TIME, (Told) {.value = duration});
    if (duration > LONGEST_STEP) return refuse(screen, TEXT_LONG_TIME, (Told) {.value = duration, .limit = LONGEST_STEP});
    fmi2Status status = run(screen, &screen->laid, COMMAND_ADVANCE, duration);
    if (status == fmi2OK) screen->time = now + duration;
    return status;
}

/* --- variables -------------------------------------------------------------------------------- */
/* Whether all references are variables of a kind; tells of the first that is not. */
static fmi2Status check_kind(const Screen *screen, const fmi2ValueReference vr[], size_t n, int kind) {
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= N_VALUES || !FLAGS[vr[k]]) return refuse(screen, TEXT_NO_VARIABLE, (Told) {.value = vr[k]});
        if (!(FLAGS[vr[k]] & kind)) {
            const Variable *variable = VARIABLE + vr[k];
            return refuse(screen, TEXT_OTHER_TYPE, (Told) {.name = variable->name, .kind = variable->kind});
        }
    }
    return fmi2OK;
}

static fmi2Status before_get(Screen *screen, const fmi2ValueReference vr[], size_t n, const void *values, int kind) {
    if (!screen) return fmi2Error;
    if (n && (!vr || !values)) return refuse(screen, TEXT_TOO_LONG, (Told) {.name = "fmi2Get"});
    if (check_kind(screen, vr, n, kind) != fmi2OK) return fmi2Error;
    read_outputs(screen);
    return fmi2OK;
}

static fmi2Status before_set(Screen *screen, const fmi2ValueReference vr[], size_t n, const void *values, int kind) {
    if (!screen) return fmi2Error;
    if (n && (!vr || !values)) return refuse(screen, TEXT_TOO_LONG, (Told) {.name = "fmi2Set"});
    if (check_kind(screen, vr, n, kind) != fmi2OK) return fmi2Error;
    for (size_t k = 0; k < n; k++) {
        Told told = {.name = VARIABLE[vr[k]].name};
        if (!(FLAGS[vr[k]] & SETTABLE)) return refuse(screen, TEXT_NOT_SETTABLE, told);
        if (screen->running && FLAGS[vr[k]] & FIXED) return refuse(screen, TEXT_FIXED, told);
    }
    return fmi2OK;
}

#define ROW(c) (((Screen *) (c))->laid.buffer + PARAMETERS)
#define GET(Type, KIND, convert)                                                                              \
    fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2##Type value[]) {  \
        if (before_get(c, vr, n, value, KIND) != fmi2OK) return fmi2Error;                                    \
        for (size_t k = 0; k < n; k++) value[k] = convert;                                                    \
        return fmi2OK;                                                                                        \
    }
#define SET(Type, KIND)                                                                                             \
    fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2##Type value[]) {  \
        if (before_set(c, vr, n, value, KIND) != fmi2OK) return fmi2Error;                                          \
        for (size_t k = 0; k < n; k++) ROW(c)[vr[k]] = (double) value[k];                                           \
        return fmi2OK;                                                                                              \
    }

/* Tools read all that they show as real numbers. */
GET(Real, REAL | INTEGER | BOOLEAN, ROW(c)[vr[k]])
GET(Integer, INTEGER, (fmi2Integer) ROW(c)[vr[k]])
GET(Boolean, BOOLEAN, ROW(c)[vr[k]] != 0)
SET(Real, REAL)
SET(Integer, INTEGER)
SET(Boolean, BOOLEAN)

/* There are no texts. */
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    return before_get(c, vr, n, value, STRING);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    return before_set(c, vr, n, value, STRING);
}

/* --- state ------------------------------------------------------------------------------------ */
static int64_t count_of(const Screen *screen) { return screen->laid.at.work - PARAMETERS; }

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *target) {
    Screen *screen = c;
    if (!screen || !target) return fmi2Error;
    int64_t count = count_of(screen);
    State *state = *target;
    if (!state || state->count != count) {
        size_t size = sizeof *state + (size_t) count * sizeof(double);
        state = malloc(size);
        if (!state) return refuse(screen, TEXT_NO_ROOM, (Told) {.value = (double) size});
        free(*target);
        *target = state;
    }
    state->running = screen->running;
    state->count = count;
    state->time = screen->time;
    memcpy(state->body, screen->laid.buffer + PARAMETERS, (size_t) count * sizeof(double));
    return fmi2OK;
}

/* A state brings its fixed parameters. */
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate source) {
    Screen *screen = c;
    const State *state = source;
    if (!screen || !state) return fmi2Error;
    Laid *laid = &screen->laid, made = *laid;
    int other = !same_fixed(state->body, laid->built_with);
    if (other && lay(screen, state->body, &made) != fmi2OK) {
        free(made.buffer);
        return fmi2Error;
    }
    int64_t count = made.at.work - PARAMETERS;
    if (state->count != count) {
        if (other) free(made.buffer);
        Told told = {.value = 8.0 * (double) state->count, .limit = 8.0 * (double) count};
        return refuse(screen, TEXT_STATE_SIZE, told);
    }
    if (other) {
        free(laid->buffer);
        *laid = made;
    }
    memcpy(laid->buffer + PARAMETERS, state->body, (size_t) count * sizeof(double));
    screen->running = (int) state->running;
    screen->ended = 0;
    screen->time = state->time;
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!c || !state) return fmi2Error;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

/* CRC-32 as zlib's. */
static uint32_t checksum(const void *bytes, size_t size) {
    uint32_t half[16], sum = 0xFFFFFFFFu;
    for (uint32_t k = 0; k < 16; k++) {
        half[k] = k;
        for (int bit = 0; bit < 4; bit++) half[k] = half[k] >> 1 ^ (half[k] & 1 ? 0xEDB88320u : 0);
    }
    for (const unsigned char *at = bytes; size--; at++) {
        sum = sum >> 4 ^ half[(sum ^ *at) & 15];
        sum = sum >> 4 ^ half[(sum ^ *at >> 4) & 15];
    }
    return ~sum;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate source, size_t *size) {
    const State *state = source;
    if (!c || !state || !size) return fmi2Error;
    *size = sizeof(Head) + (size_t) state->count * sizeof(double);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate source, fmi2Byte bytes[], size_t size) {
    const State *state = source;
    size_t needed = 0;
    if (fmi2SerializedFMUstateSize(c, source, &needed) != fmi2OK || !bytes) return fmi2Error;
    if (size < needed) {
        Told told = {.value = (double) size, .limit = (double) needed};
        return refuse(c, TEXT_STATE_SIZE, told);
    }
    size_t length = needed - sizeof(Head);
    Head head = {.running = (uint64_t) state->running, .checksum = checksum(state->body, length)};
    memcpy(head.mark, STATE_MARK, sizeof head.mark);
    memcpy(head.owner, OWNER, sizeof head.owner);
    memcpy(bytes, &head, sizeof head);
    memcpy(bytes + sizeof head, state->body, length);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *target) {
    const Screen *screen = c;
    if (!screen || !bytes || !target) return fmi2Error;
    Told told = {.name = MODEL, .value = (double) size, .limit = (double) (count_of(screen) * 8) + sizeof(Head)};
    Head head;
    if (size < sizeof head || memcmp(bytes, STATE_MARK, sizeof head.mark))
        return refuse(screen, TEXT_NO_STATE, told);
    memcpy(&head, bytes, sizeof head);
    if (memcmp(head.owner, OWNER, sizeof head.owner)) return refuse(screen, TEXT_OTHER_BUILD, told);
    size_t length = size - sizeof head;
    if (head.checksum != checksum(bytes + sizeof head, length)) return refuse(screen, TEXT_BROKEN_STATE, told);
    if (length % sizeof(double) || (int64_t) (length / sizeof(double)) < screen->laid.at.constants - PARAMETERS)
        return refuse(screen, TEXT_STATE_SIZE, told);
    State *state = malloc(sizeof *state + length);
    if (!state) return refuse(screen, TEXT_NO_ROOM, told);
    state->running = head.running != 0;
    state->time = screen->time; /* bytes of a state do not say when it was */
    state->count = (int64_t) (length / sizeof(double));
    memcpy(state->body, bytes + sizeof head, length);
    *target = state;
    return fmi2OK;
}

/* --- what is not offered, and status ---------------------------------------------------------- */
static fmi2Status not_offered(const Screen *screen, const char *name) {
    return screen ? refuse(screen, TEXT_NOT_OFFERED, (Told) {.name = name}) : fmi2Error;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t unknowns,
                                        const fmi2ValueReference known[], size_t knowns, const fmi2Real seed[],
                                        fmi2Real value[]) {
    (void) unknown, (void) unknowns, (void) known, (void) knowns, (void) seed, (void) value;
    return not_offered(c, "fmi2GetDirectionalDerivative");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    (void) vr, (void) n, (void) order, (void) value;
    return not_offered(c, "fmi2SetRealInputDerivatives");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    (void) vr, (void) n, (void) order, (void) value;
    return not_offered(c, "fmi2GetRealOutputDerivatives");
}

fmi2Status fmi2CancelStep(fmi2Component c) { return not_offered(c, "fmi2CancelStep"); }

/* Steps end before the call does: nothing is ever pending. */
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    (void) kind, (void) value;
    return c ? fmi2Discard : fmi2Error;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (!c || !value) return fmi2Error;
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Screen *) c)->time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void) kind, (void) value;
    return c ? fmi2Discard : fmi2Error;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (!c || !value) return fmi2Error;
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void) kind, (void) value;
    return c ? fmi2Discard : fmi2Error;
}
