/* FMI 2.0 for co-simulation over the kernels of the engine; the same library for every screen.

   All of an instance lies in one buffer [header | parameters | inputs | outputs | constants | state
   | work] (kernels/state.py); the value reference of a variable is its place from the parameters
   on. Nothing that changes lies outside of an instance: instances may run in threads of their own.
   Memory is taken when an instance is made, when fixed parameters change the size of its state,
   and for saved states; never in a step. Offsets are in engine.h (header.py writes it); names, texts,
   limits and start values are in the sheet of a screen (sheet.h). */
#define _GNU_SOURCE /* dladdr */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2.h"
#include "place.h"

#include "engine.h"
#include "sheet.h"

#define DEGREE 0.017453292519943295

/* A buffer, where its sections lie, and the parameters that it was laid out for. */
typedef struct {
    double *buffer, *built_with;
    Sections at;
} Laid;

typedef struct {
    Sheet sheet;
    Laid laid;
    char *name;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    int logging, running, ended;
    double time;
    void *own;                   /* library of a user's own sub-models */
    double address[OWN_MODELS]; /* theirs */
} Screen;

/* What is logged: bits of `logging`. */
enum { ERRORS = 1, WARNINGS = 2 };

/* Told before there is a sheet. */
#define NO_INSTANCE "{name} = {other} makes no instance: give a name and fmi2CoSimulation"
#define NO_SHEET "guid = {name} has no resources/screen.bin here: {other}: unpack the whole FMU anew and leave it together"
#define NO_OWN "{name} is missing or does not load: unpack the whole FMU anew and leave it together"

/* A saved state: what an instance must remember, from the parameters to the end of the state. */
typedef struct {
    int64_t running, count;
    double time, body[];
} State;

/* What goes before the body when a state is written. */
typedef struct {
    char mark[8];
    unsigned char owner[16];
    uint64_t running;
    double time;
    uint64_t checksum; /* of what the head says after the owner, and of the body */
} Head;

/* What the braces of a text stand for. */
typedef struct {
    const char *name, *unit, *range, *cure, *kind, *other;
    double value, limit, other_limit, number, meant;
} Told;

/* --- messages --------------------------------------------------------------------------------- */
typedef struct {
    char text[4096];
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
    if (is(key, n, "meant")) return told->meant;
    if (is(key, n, "degrees")) return told->value / DEGREE;
    if (is(key, n, "slope")) return tan(told->value);
    return told->number;
}

static const char *text_named(const char *key, size_t n, const Told *told) {
    if (is(key, n, "name")) return told->name;
    if (is(key, n, "unit")) return told->unit;
    if (is(key, n, "range")) return told->range;
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
        } else if (is(key, n, "cure")) tell(message, told->cure, told);
        else add_text(message, text_named(key, n, told));
        text = key + strcspn(key, "}") + 1;
    }
}

/* Log a text behind a title, if there is one. */
static void say_of(const Screen *screen, fmi2Status status, const char *title, const char *text, Told told) {
    if (!screen->logger || !(screen->logging & (status == fmi2Warning ? WARNINGS : ERRORS))) return;
    Message message = {.used = 0};
    add_text(&message, title);
    add_text(&message, title ? ": " : "");
    tell(&message, text, &told);
    /* A host takes the message for a format; some show it as it is. Both get what was meant. */
    const char *format = strchr(message.text, '%') ? "%s" : message.text;
    const char *category = status == fmi2Warning ? "logStatusWarning" : "logStatusError";
    screen->logger(screen->environment, screen->name, status, category, format, message.text);
}

static void say(const Screen *screen, fmi2Status status, const char *text, Told told) {
    say_of(screen, status, NULL, text, told);
}

static const char *word(const Screen *screen, int32_t place) { return screen->sheet.word + place; }

static const char *name_of(const Screen *screen, int64_t reference) {
    return word(screen, screen->sheet.variable[reference].name);
}

static fmi2Status refuse(const Screen *screen, int text, Told told) {
    say(screen, fmi2Error, word(screen, screen->sheet.text[text]), told);
    return fmi2Error;
}

/* --- the engine ------------------------------------------------------------------------------- */
/* Whether a value is far out of its range, and in it as a number of the unit that it is mistaken for. */
static int in_another_unit(const double *buffer, int64_t place, Told told) {
    const double *range = buffer + (int64_t) buffer[AT_LIMIT] + 2 * (place - PARAMETERS);
    int distant =
        fabs(told.value) > FAR_OUT * fmax(fabs(range[0]), fabs(range[1])) || told.value < range[0] / FAR_OUT;
    return distant && range[0] <= told.meant && told.meant <= range[1];
}

/* Tell what the kernels refuse. */
static fmi2Status judge(const Screen *screen, const Laid *laid, int64_t code) {
    if (code < 0 || code >= screen->sheet.codes)
        return refuse(screen, TEXT_FAILED, (Told) {.value = (double) code});
    if (code == ACCEPTED) return fmi2OK;
    const double *buffer = laid->buffer, *refusal = buffer + (int64_t) buffer[AT_REFUSAL];
    int64_t place = (int64_t) refusal[1];
    const Variable *variable = screen->sheet.variable + (place - PARAMETERS);
    int text = screen->sheet.text_of_code[code];
    Told told = {
        .name = word(screen, variable->name), .unit = word(screen, variable->unit),
        .range = word(screen, variable->range), .value = refusal[2], .limit = refusal[3], .number = buffer[place],
        .cure = word(screen, variable->cure), .meant = refusal[2] * screen->sheet.other_unit[place - PARAMETERS],
    };
    if ((text == TEXT_TOO_SMALL || text == TEXT_TOO_LARGE) && in_another_unit(buffer, place, told))
        told.cure = word(screen, variable->question);
    return refuse(screen, text, told);
}

/* Carry out a command. */
static fmi2Status run(const Screen *screen, const Laid *laid, int command, double first) {
    return judge(screen, laid, vibroscreen_run(laid->buffer, laid->at.size, command, first, 0));
}

/* Where the alarms stand among the variables. */
static int64_t alarm_place(const double *buffer) { return (int64_t) buffer[AT_OUTPUT] + FIRST_ALARM; }

/* Which alarms are set, a bit each. */
static unsigned alarms_of(const double *buffer) {
    unsigned set = 0;
    for (int k = 0; k < ALARMS; k++) set |= (unsigned) (buffer[alarm_place(buffer) + k] != 0) << k;
    return set;
}

/* Tell why alarms came on that were not set before. */
static void tell_alarms(const Screen *screen, unsigned before) {
    const double *buffer = screen->laid.buffer, *why = buffer + (int64_t) buffer[AT_ALARM];
    unsigned new = alarms_of(buffer) & ~before;
    for (int k = 0; k < ALARMS; k++, why += WHY_SIZE) {
        int64_t reason = (int64_t) why[WHY_REASON];
        if (!(new >> k & 1) || reason < 1 || reason >= screen->sheet.reasons) continue;
        Told told = {.value = why[WHY_VALUE], .limit = why[WHY_LIMIT], .other_limit = why[WHY_OTHER],
                     .number = why[WHY_DECK]};
        int text = screen->sheet.text_of_reason[reason];
        const char *name = name_of(screen, alarm_place(buffer) + k - PARAMETERS);
        say_of(screen, fmi2Warning, name, word(screen, screen->sheet.text[text]), told);
    }
}

/* Outputs that are found only when they are read. */
static void read_outputs(Screen *screen) {
    const double *buffer = screen->laid.buffer;
    if (buffer[(int64_t) buffer[AT_MEMORY] + M_UNREAD] <= 0) return;
    unsigned before = alarms_of(buffer);
    run(screen, &screen->laid, COMMAND_READ, 0);
    tell_alarms(screen, before);
}

/* A zeroed buffer of so many numbers, at a line of the processor's cache; what was allocated is told
   before it. */
static double *allocate(size_t numbers) {
    char *room = calloc(numbers + 2 * LINE, sizeof(double));
    if (!room) return NULL;
    size_t line = LINE * sizeof(double);
    char *buffer = room + line + (line - (uintptr_t) room % line) % line;
    memcpy(buffer - sizeof room, &room, sizeof room);
    return (double *) buffer;
}

static void release(double *buffer) {
    char *room = NULL;
    if (buffer) memcpy(&room, (char *) buffer - sizeof room, sizeof room);
    free(room);
}

/* A zeroed buffer with room for the dimensions in its header, and for the parameters behind it. */
static fmi2Status make_buffer(const Screen *screen, const double *dimensions, Laid *made) {
    double header[HEADER];
    memcpy(header, dimensions, N_DIMENSIONS * sizeof(double));
    made->at = lay_out(header);
    size_t parameters = (size_t) (made->at.inputs - PARAMETERS), whole = (size_t) made->at.size + parameters;
    made->buffer = allocate(whole);
    if (!made->buffer) return refuse(screen, TEXT_NO_ROOM, (Told) {.value = 8.0 * (double) whole});
    made->built_with = made->buffer + made->at.size;
    memcpy(made->buffer, header, sizeof header);
    return fmi2OK;
}

/* Fill in a slice of the bed for these fixed parameters, and what follows from them. */
static fmi2Status plan_slice(const Screen *screen, const double *parameters, Laid *slice) {
    const Sheet *sheet = &screen->sheet;
    double dimensions[N_DIMENSIONS];
    memcpy(dimensions, sheet->dimension, sizeof dimensions);
    double model = parameters[P_SEGREGATION_MODEL];
    int layered = model == EXCHANGE || (model == sheet->start[P_SEGREGATION_MODEL] && sheet->figure[F_OWN_LAYERED]);
    dimensions[D_LAYERED] = layered;
    dimensions[D_LAYERS] = layered ? sheet->dimension[D_BED_LAYERS] : 1;
    if (make_buffer(screen, dimensions, slice) != fmi2OK) return fmi2Error;
    double *buffer = slice->buffer;
    memcpy(buffer + PARAMETERS, sheet->start, (size_t) sheet->starts * sizeof(double));
    for (int64_t k = 0; k < sheet->fixed; k++)
        buffer[PARAMETERS + sheet->fixed_one[k]] = parameters[sheet->fixed_one[k]];
    int64_t classes = (int64_t) sheet->dimension[D_CLASSES];
    double *edge = buffer + (int64_t) buffer[AT_EDGE];
    memcpy(edge, buffer + (int64_t) buffer[AT_LOWER], (size_t) classes * sizeof(double));
    edge[classes] = buffer[(int64_t) buffer[AT_UPPER] + classes - 1];
    double *aperture = (double *) sheet->aperture, *velocity = (double *) sheet->velocity;
    int64_t code = vibroscreen_plan(buffer, slice->at.size, aperture, sheet->rows, velocity, sheet->rows);
    if (judge(screen, slice, code) != fmi2OK) return fmi2Error;
    double cells = buffer[D_CELLS], room = sheet->figure[F_ROOM];
    if (room > 0 && room < cells + 4)
        return refuse(screen, TEXT_LITTLE_ROOM, (Told) {.value = room, .limit = cells, .other_limit = cells + 4});
    return fmi2OK;
}

/* Lay out a screen of these parameters: constants are filled in, inputs are those of the start. */
static fmi2Status lay(const Screen *screen, const double *parameters, Laid *made) {
    const Sheet *sheet = &screen->sheet;
    Laid slice = {.buffer = NULL};
    made->buffer = NULL;
    fmi2Status status = plan_slice(screen, parameters, &slice);
    if (status == fmi2OK) {
        double dimensions[N_DIMENSIONS];
        memcpy(dimensions, slice.buffer, sizeof dimensions);
        double room = sheet->figure[F_ROOM];
        dimensions[D_PACKAGES] = room > 0 ? room : 4 * dimensions[D_CELLS] + 16;
        dimensions[D_FALLS] = sheet->dimension[D_DECKS] > 1 ? dimensions[D_PACKAGES] : 1;
        for (int k = 0; k < OWN_MODELS; k++)
            if (screen->address[k]) dimensions[D_DISPLACEMENT_ADDRESS + k] = screen->address[k];
        status = make_buffer(screen, dimensions, made);
    }
    if (status == fmi2OK) {
        double *buffer = made->buffer, *from = slice.buffer;
        for (int field = AT_FIRST + 1; field < AT_FIRST_OF_STATE; field++) {
            double stop = field + 1 < AT_FIRST_OF_STATE ? buffer[field + 1] : (double) made->at.state;
            size_t size = (size_t) (stop - buffer[field]);
            memcpy(buffer + (int64_t) buffer[field], from + (int64_t) from[field], size * sizeof(double));
        }
        for (int64_t k = 0; k < sheet->tunable; k++) {
            int reference = sheet->tunable_one[k];
            if (parameters[reference] != sheet->start[reference]) buffer[PARAMETERS + reference] = parameters[reference];
        }
        memcpy(made->built_with, buffer + PARAMETERS, (size_t) (made->at.inputs - PARAMETERS) * sizeof(double));
    }
    release(slice.buffer);
    return status;
}

static int same_fixed(const Sheet *sheet, const double *one, const double *two) {
    for (int64_t k = 0; k < sheet->fixed; k++)
        if (one[sheet->fixed_one[k]] != two[sheet->fixed_one[k]]) return 0;
    return 1;
}

/* Lay out a screen like another, with its parameters, inputs and constants. Most of a state stays
   untouched memory of zeros: that is faster than to clear the one that there is. */
static fmi2Status lay_like(const Screen *screen, const Laid *laid, Laid *made) {
    if (make_buffer(screen, laid->buffer, made) != fmi2OK) return fmi2Error;
    const Sections *at = &laid->at;
    size_t parameters = (size_t) (at->inputs - PARAMETERS) * sizeof(double);
    size_t given = (size_t) (at->outputs - PARAMETERS) * sizeof(double);
    size_t constants = (size_t) (at->state - at->constants) * sizeof(double);
    memcpy(made->buffer + PARAMETERS, laid->buffer + PARAMETERS, given);
    memcpy(made->buffer + at->constants, laid->buffer + at->constants, constants);
    memcpy(made->built_with, laid->built_with, parameters);
    return fmi2OK;
}

static fmi2Status start_afresh(Screen *screen) {
    Laid made;
    fmi2Status status = lay(screen, screen->sheet.start, &made);
    if (status == fmi2OK) status = run(screen, &made, COMMAND_INITIALISE, 0);
    if (status != fmi2OK) {
        release(made.buffer);
        return status;
    }
    release(screen->laid.buffer);
    screen->laid = made;
    screen->running = screen->ended = 0;
    screen->time = 0;
    return fmi2OK;
}

/* --- life of an instance ---------------------------------------------------------------------- */
const char *fmi2GetTypesPlatform(void) { return "default"; }

const char *fmi2GetVersion(void) { return "2.0"; }

/* Find the sheet: beside this library, else where the host says. */
static fmi2Status find_sheet(Screen *asking, const char *guid, const char *resources) {
    char *place[] = {beside(2, "resources/screen.bin"), located(resources, "screen.bin")};
    Message tried = {.used = 0};
    const char *wrong = "";
    for (int k = 0; k < 2; k++) {
        wrong = place[k] ? read_sheet(&asking->sheet, open_file(place[k]), guid) : "names no folder";
        if (!wrong) break;
        free((void *) asking->sheet.bytes);
        asking->sheet.bytes = NULL;
        add_text(&tried, k ? "; " : "");
        add_text(&tried, place[k] ? place[k] : k ? "the resource location" : "the library's own path");
        add_text(&tried, " ");
        add_text(&tried, wrong);
    }
    free(place[0]), free(place[1]);
    if (!wrong) return fmi2OK;
    say(asking, fmi2Error, NO_SHEET, (Told) {.name = guid ? guid : "", .other = tried.text});
    return fmi2Error;
}

/* Load a user's own sub-models from the library of theirs beside this one. */
static fmi2Status load_own(Screen *screen) {
    char file[256];
    int wanted = 0;
    for (int k = 0; k < OWN_MODELS; k++) wanted += screen->sheet.figure[F_OWN + k] != 0;
    if (!wanted) return fmi2OK;
    snprintf(file, sizeof file, "%s_own" SUFFIX, screen->sheet.model);
    char *path = beside(0, file);
    screen->own = path ? load(path) : NULL;
    for (int k = 0; screen->own && k < OWN_MODELS; k++) {
        if (screen->sheet.figure[F_OWN + k] == 0) continue;
        screen->address[k] = (double) (uintptr_t) find(screen->own, OWN_MODEL[k]);
        wanted -= screen->address[k] != 0;
    }
    if (wanted) say(screen, fmi2Error, NO_OWN, (Told) {.name = path ? path : file});
    free(path);
    return wanted ? fmi2Error : fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void) visible;
    if (!functions) return NULL;
    Screen asking = {.name = (char *) (name ? name : ""), .logger = functions->logger,
                     .environment = functions->componentEnvironment, .logging = ERRORS | WARNINGS};
    if (!name || !*name || type != fmi2CoSimulation) {
        say(&asking, fmi2Error, NO_INSTANCE, (Told) {.name = "fmi2Instantiate", .other = asking.name});
        return NULL;
    }
    if (find_sheet(&asking, guid, resources) != fmi2OK) return NULL;
    Screen *screen = malloc(sizeof *screen);
    if (screen) {
        *screen = asking;
        screen->name = malloc(strlen(name) + 1);
        if (screen->name) strcpy(screen->name, name);
        if (screen->name && load_own(screen) == fmi2OK && start_afresh(screen) == fmi2OK) {
            screen->logging = logging ? ERRORS | WARNINGS : 0;
            return screen;
        }
    } else free((void *) asking.sheet.bytes);
    fmi2FreeInstance(screen);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c) {
    Screen *screen = c;
    if (!screen) return;
    release(screen->laid.buffer);
    free(screen->name);
    free((void *) screen->sheet.bytes);
    if (screen->own) unload(screen->own);
    free(screen);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    Screen *screen = c;
    if (!screen) return fmi2Error;
    int wanted = n == 0 ? ERRORS | WARNINGS : 0;
    for (size_t k = 0; categories && k < n; k++) {
        const char *category = categories[k] ? categories[k] : "";
        if (!strcmp(category, "logAll")) wanted = ERRORS | WARNINGS;
        if (!strcmp(category, "logStatusError")) wanted |= ERRORS;
        if (!strcmp(category, "logStatusWarning")) wanted |= WARNINGS;
    }
    screen->logging = on ? screen->logging | wanted : screen->logging & ~wanted;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean bounded, fmi2Real tolerance, fmi2Real begin,
                               fmi2Boolean ends, fmi2Real end) {
    Screen *screen = c;
    (void) ends, (void) end;
    if (!screen) return fmi2Error;
    screen->time = begin;
    if (!bounded) return fmi2OK;
    double *own = screen->laid.buffer + PARAMETERS + P_SOLVER_TOLERANCE;
    const char *name = name_of(screen, P_SOLVER_TOLERANCE);
    if (screen->running) return refuse(screen, TEXT_FIXED, (Told) {.name = name});
    double least = screen->sheet.figure[F_TOLERANCE_LEAST], most = screen->sheet.figure[F_TOLERANCE_MOST];
    if (tolerance >= least && tolerance <= most) {
        *own = tolerance;
        return fmi2OK;
    }
    Told told = {.name = "tolerance", .other = name, .value = tolerance, .number = *own, .limit = least, .other_limit = most};
    say(screen, fmi2Warning, word(screen, screen->sheet.text[TEXT_NO_TOLERANCE]), told);
    return fmi2Warning;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

/* The screen starts with the parameters and inputs set so far; if it cannot, all stays. */
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Screen *screen = c;
    if (!screen) return fmi2Error;
    if (screen->running) return refuse(screen, TEXT_STARTED, (Told) {.value = 0});
    Laid *laid = &screen->laid, made = {.buffer = NULL};
    const double *parameters = laid->buffer + PARAMETERS;
    fmi2Status status = run(screen, laid, COMMAND_CHECK, 0);
    if (status != fmi2OK) return status;
    if (same_fixed(&screen->sheet, parameters, laid->built_with)) status = lay_like(screen, laid, &made);
    else if ((status = lay(screen, parameters, &made)) == fmi2OK) {
        size_t inputs = (size_t) (laid->at.outputs - laid->at.inputs) * sizeof(double);
        memcpy(made.buffer + made.at.inputs, laid->buffer + laid->at.inputs, inputs);
    }
    if (status == fmi2OK) status = run(screen, &made, COMMAND_INITIALISE, 0);
    if (status != fmi2OK) {
        release(made.buffer);
        return status;
    }
    release(laid->buffer);
    *laid = made;
    screen->running = 1;
    tell_alarms(screen, 0);
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
    double longest = screen->sheet.figure[F_LONGEST_STEP];
    if (!(duration >= screen->sheet.figure[F_SHORTEST_STEP] && duration <= 1.7976931348623157e308))
        return refuse(screen, TEXT_NO_TIME, (Told) {.value = duration});
    if (duration > longest) return refuse(screen, TEXT_LONG_TIME, (Told) {.value = duration, .limit = longest});
    unsigned before = alarms_of(screen->laid.buffer);
    fmi2Status status = run(screen, &screen->laid, COMMAND_ADVANCE, duration);
    if (status != fmi2OK) return status;
    screen->time = now + duration;
    tell_alarms(screen, before);
    return status;
}

/* --- variables -------------------------------------------------------------------------------- */
/* Whether all references are variables of a kind; tells of the first that is not. */
static fmi2Status check_kind(const Screen *screen, const fmi2ValueReference vr[], size_t n, int kind) {
    const unsigned char *flags = screen->sheet.flags;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= screen->sheet.values || !flags[vr[k]])
            return refuse(screen, TEXT_NO_VARIABLE, (Told) {.value = vr[k]});
        if (!(flags[vr[k]] & kind)) {
            const char *type = word(screen, screen->sheet.variable[vr[k]].kind);
            return refuse(screen, TEXT_OTHER_TYPE, (Told) {.name = name_of(screen, vr[k]), .kind = type});
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
        int flags = screen->sheet.flags[vr[k]];
        if (flags & SETTABLE && !(screen->running && flags & FIXED)) continue;
        Told told = {.name = name_of(screen, vr[k])};
        return refuse(screen, flags & SETTABLE ? TEXT_FIXED : TEXT_NOT_SETTABLE, told);
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
GET(Real, KIND_REAL | KIND_INTEGER | KIND_BOOLEAN, ROW(c)[vr[k]])
GET(Integer, KIND_INTEGER, (fmi2Integer) ROW(c)[vr[k]])
GET(Boolean, KIND_BOOLEAN, ROW(c)[vr[k]] != 0)
SET(Real, KIND_REAL)
SET(Integer, KIND_INTEGER)
SET(Boolean, KIND_BOOLEAN)

/* There are no texts. */
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    return before_get(c, vr, n, value, KIND_STRING);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    return before_set(c, vr, n, value, KIND_STRING);
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
    int other = !same_fixed(&screen->sheet, state->body, laid->built_with);
    if (other && lay(screen, state->body, &made) != fmi2OK) {
        release(made.buffer);
        return fmi2Error;
    }
    int64_t count = made.at.work - PARAMETERS;
    if (state->count != count) {
        if (other) release(made.buffer);
        Told told = {.value = 8.0 * (double) state->count, .limit = 8.0 * (double) count};
        return refuse(screen, TEXT_STATE_SIZE, told);
    }
    if (other) {
        release(laid->buffer);
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

/* The checksum of a state in bytes, head and body. */
static uint64_t checksum_of(const Head *head, const void *body, size_t length) {
    uint32_t sum = checksum(0, &head->running, sizeof head->running);
    return checksum(checksum(sum, &head->time, sizeof head->time), body, length);
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
    Head head = {.running = (uint64_t) state->running, .time = state->time};
    memcpy(head.mark, STATE_MARK, sizeof head.mark);
    memcpy(head.owner, ((const Screen *) c)->sheet.owner, sizeof head.owner);
    head.checksum = checksum_of(&head, state->body, length);
    memcpy(bytes, &head, sizeof head);
    memcpy(bytes + sizeof head, state->body, length);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *target) {
    const Screen *screen = c;
    if (!screen || !bytes || !target) return fmi2Error;
    Told told = {.name = screen->sheet.model, .value = (double) size, .limit = (double) (count_of(screen) * 8) + sizeof(Head)};
    Head head;
    if (size < sizeof head || memcmp(bytes, STATE_MARK, sizeof head.mark))
        return refuse(screen, TEXT_NO_STATE, told);
    memcpy(&head, bytes, sizeof head);
    if (memcmp(head.owner, screen->sheet.owner, sizeof head.owner)) return refuse(screen, TEXT_OTHER_BUILD, told);
    size_t length = size - sizeof head;
    if (head.checksum != checksum_of(&head, bytes + sizeof head, length)) return refuse(screen, TEXT_BROKEN_STATE, told);
    if (length % sizeof(double) || (int64_t) (length / sizeof(double)) < screen->laid.at.constants - PARAMETERS)
        return refuse(screen, TEXT_STATE_SIZE, told);
    State *state = malloc(sizeof *state + length);
    if (!state) return refuse(screen, TEXT_NO_ROOM, told);
    state->running = head.running != 0;
    state->time = head.time;
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
    *value = 0;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void) kind, (void) value;
    return c ? fmi2Discard : fmi2Error;
}
