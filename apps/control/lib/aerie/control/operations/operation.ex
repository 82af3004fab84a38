defmodule Aerie.Control.Operations.Operation do
  @moduledoc """
  One thing that a program can ask for, declared in one file below `operations/`: its name, what it does, its fields
  and its answer. NATS, REST, their errors, `docs/asyncapi.json` and `docs/openapi.json` are made from it.

      defmodule Aerie.Control.Operations.Params.Set do
        use Aerie.Control.Operations.Operation

        @impl true
        def operation do
          %Operation{
            name: "params.set",
            meaning: "Sets one parameter.",
            changes?: true,
            fields: [param_name(), field(:value, …), component()],
            routes: [put("/api/vehicles/:id/params/:name", "Sets a parameter.", query: [:component])]
          }
        end

        @impl true
        def run(input, context), do: Params.set(context.gateway, context.vehicle, input.name, input.value, …)
      end

    * `:module` - the file's module, filled in by `Aerie.Control.Operations`
    * `:name` - area and action, as in the subject of NATS
    * `:transfer?` - it reads or changes what a vehicle has stored, which takes time: it has the fields of `common/1`,
      the answer of a change is a result, and unknown keys are refused
    * `:closed?` - unknown keys are refused, as for a transfer
    * `:changes?` - it changes the vehicle: it is carried out like a command, so it may have an id, and its answer is
      a result
    * `:fields` - its own
    * `:request` - in place of fields, the JSON Schema of the whole request, which `c:run/2` gets as `object` and checks
    * `:once` - `{field, when, reason}`: the field without which a copy of a message would be another request; `:signed`
      or `:always`, and what is said if it is missing. Over NATS only
    * `:rules` - further keywords of the request's JSON Schema, for what fields cannot say; `c:run/2` checks them
    * `:answer` - the properties of what `c:run/2` answers, or the fields that show it (`Aerie.Base.Json.Object`), the
      names of schemas of the interface, or `:result`, that of a command
    * `:answer_as` - names the answer where several operations have the same one
    * `:routes` - how it is asked for over REST
  """

  alias Aerie.Base.{Json, Names}
  alias Aerie.Base.Settings.{Field, Schema}
  alias Aerie.Control.Operations.Route
  alias Aerie.Control.Transfers
  alias Aerie.Control.Policy.Roles
  alias Aerie.Vehicle.Command.{Error, Result}

  @enforce_keys [:name, :meaning]
  defstruct [
    :module,
    :name,
    :meaning,
    :request,
    :once,
    :answer_as,
    changes?: false,
    transfer?: true,
    closed?: false,
    fields: [],
    rules: [],
    answer: %{},
    routes: []
  ]

  @type t :: %__MODULE__{
          module: module() | nil,
          name: String.t(),
          meaning: String.t(),
          request: Json.Schema.t() | nil,
          once: {field :: String.t(), :signed | :always, reason :: String.t()} | nil,
          answer_as: String.t() | nil,
          changes?: boolean(),
          transfer?: boolean(),
          closed?: boolean(),
          fields: [Field.t()],
          rules: keyword(),
          answer: %{atom() => Json.Schema.t()} | [Json.Object.t()] | [atom(), ...] | :result,
          routes: [Route.t()]
        }

  @typedoc "The fields by their names, with their defaults; nil for one that was left out."
  @type input :: %{atom() => term()}

  @typedoc """
    * `:vehicle` - nil for what concerns the gateway
    * `:source` - who asks; nil if that does not matter
    * `:by` - who asks, for the records of what is changed of the gateway; nil where nothing of it can be changed
    * `:options` - `t:Aerie.Control.Transfers.option/0`
    * `:format` - the form of a file that is read or sent (`Aerie.Control.Operations.Route`); `"json"` unless REST
      chose another
    * `:max_bytes` - the most that an answer can have; nil: whatever the operation allows
    * `:signed` - over REST the header `Aerie-Signature` (nil: none) and the body as it was sent
  """
  @type context :: %{
          :gateway => Names.gateway(),
          :vehicle => String.t() | nil,
          :source => Roles.source() | nil,
          :via => String.t(),
          :by => String.t() | nil,
          :options => [Transfers.option()],
          :format => String.t(),
          :max_bytes => pos_integer() | nil,
          optional(:signed) => %{header: String.t() | nil, body: binary()}
        }

  @typedoc """
  `:ok`: it is done, and there is nothing else to say. `:file` is the text of a file in the context's format, `:bytes`
  one of any kind.
  """
  @type answer ::
          :ok
          | {:ok,
             map()
             | {:file, name :: String.t(), iodata()}
             | {:bytes, iodata(), name :: String.t()}
             | Result.t()}
          | {:pending, id :: String.t()}
          | {:error,
             Result.t() | [Error.t(), ...] | {reason :: atom(), String.t() | Error.t() | [Error.t(), ...]}}

  @callback operation() :: t()
  @doc """
  Reads what costs more than a message, such as a plan, in the format in which it came. Pure, so that an interface can
  do it within its limits. `{:invalid, error}` concerns the file as a whole: its text is what is wrong.
  """
  @callback prepare(input(), format :: String.t()) ::
              {:ok, input()} | {:error, [Error.t(), ...] | {:invalid, Error.t()}}
  @optional_callbacks prepare: 2
  @callback run(input(), context()) :: answer()

  defmacro __using__(_options) do
    quote do
      @behaviour Aerie.Control.Operations.Operation

      import Aerie.Base.Json.Schema
      import Aerie.Control.Operations.Fields

      import Aerie.Control.Operations.Route,
        only: [get: 2, get: 3, post: 3, put: 3, patch: 2, patch: 3, delete: 2, delete: 3]

      alias Aerie.Control.Operations.Operation
    end
  end

  @max_errors 8
  # Shorter than a connection's time-out.
  @max_wait_s 20

  @doc """
  Reads a request: a map with text keys, whose values are those of JSON, or `{:text, text}` where everything is text.
  null is the same as nothing. Options:

    * `:more` - fields of the interface; `:omit` - names of fields that it does not have; `:required` - names of those
      that must be there as well
    * `:file` - `{field, bytes}`, a field that came as a file in the `:format`
  """
  @spec parse(t(), map(), keyword()) :: {:ok, input()} | {:error, [Error.t(), ...] | {:invalid, Error.t()}}
  def parse(operation, given, options \\ [])

  def parse(%__MODULE__{request: %{}}, given, options) do
    more = Keyword.get(options, :more, [])
    {own, object} = Map.split(given, Enum.map(more, &Field.name/1))

    case read(more, own) do
      {input, []} ->
        {:ok, Map.put(input, :object, Map.new(object, fn {key, value} -> {key, plain(value)} end))}

      {_input, errors} ->
        {:error, errors}
    end
  end

  def parse(%__MODULE__{} = operation, given, options) do
    format = Keyword.get(options, :format, "json")
    {file, bytes} = Keyword.get(options, :file, {nil, nil})
    required = Keyword.get(options, :required, [])

    omit = Keyword.get(options, :omit, [])

    fields =
      for field <- common(operation) ++ operation.fields ++ Keyword.get(options, :more, []),
          field.key not in [file | omit] do
        %{field | required: field.required or field.key in required}
      end

    given = Map.reject(given, fn {_key, value} -> value == nil end)

    case read(fields, given, closed?: closed?(operation)) do
      {input, []} ->
        input = Map.merge(Map.new(omit, &{&1, nil}), input)
        prepare(operation.module, if(file, do: Map.put(input, file, bytes), else: input), format)

      {_input, errors} ->
        {:error, errors}
    end
  end

  @doc """
  Reads values by their fields: the values, which are only of use without errors. `closed?: true`: no others may be
  there.
  """
  @spec read([Field.t()], map(), closed?: boolean()) :: {input(), [Error.t()]}
  def read(fields, given, options \\ []) do
    known = Enum.map(fields, &Field.name/1)
    {given, unknown} = Map.split(given, known)
    unknown = if options[:closed?], do: unknown, else: %{}
    {input, problems} = Schema.validate(fields, given)
    {input, Enum.take(Enum.map(problems, &error/1) ++ unknown(unknown, known), @max_errors)}
  end

  defp closed?(operation), do: operation.transfer? or operation.closed?

  # A text of a query may be a number.
  defp plain({:text, text}),
    do: with({:error, _no_json} <- JSON.decode(text), do: text, else: ({:ok, value} -> value))

  defp plain(value), do: value

  defp prepare(module, input, format) do
    if Code.ensure_loaded?(module) and function_exported?(module, :prepare, 2),
      do: module.prepare(input, format),
      else: {:ok, input}
  end

  defp unknown(given, known) do
    for key <- given |> Map.keys() |> Enum.take(@max_errors),
        do: Error.new(Error.key(key), "only #{Enum.join(known, ", ")}", :unknown)
  end

  defp error(problem) do
    [first | rest] = problem.path
    key = for step <- rest, into: first, do: if(is_integer(step), do: "[#{step}]", else: ".#{step}")
    got = if problem.got == "nothing (it is required)", do: "nothing", else: problem.got
    %Error{key: key, expected: problem.expected, got: got}
  end

  @doc "The fields that every transfer has."
  @spec common(t()) :: [Field.t()]
  def common(%__MODULE__{transfer?: false}), do: []

  def common(_transfer) do
    [
      Field.field(:id, :token, "the same id is the same request; progress is published with it"),
      Field.field(:timeout, {:number, 0.001, Transfers.max_timeout_s()}, "how long it may take", unit: "s")
    ]
  end

  @doc "Whether a request by a route has a body."
  @spec body?(Route.t()) :: boolean()
  defdelegate body?(route), to: Route

  @doc "How long REST waits for the result of a change."
  @spec wait() :: Field.t()
  def wait do
    meaning = "how long to wait for the result; then 202, and it goes on"
    Field.field(:wait, {:integer, 0, @max_wait_s}, meaning, default: @max_wait_s, unit: "s")
  end

  @doc "The options of `Aerie.Control.Transfers` in a request that was read."
  @spec options(input()) :: keyword()
  def options(input) do
    for {key, value} <- [
          component: input[:component],
          id: input[:id],
          timeout_ms: input[:timeout] && ceil(input.timeout * 1000),
          wait_ms: input[:wait] && input.wait * 1000
        ],
        value != nil,
        do: {key, value}
  end

  @doc "The JSON Schema of a request with its own fields (without `except`) and `more` properties."
  @spec schema(t(), more :: map(), required :: [atom()], except :: [atom()]) :: Json.Schema.t()
  def schema(operation, more, required, except \\ [])
  def schema(%__MODULE__{request: %{} = schema}, _more, _required, _except), do: schema

  def schema(%__MODULE__{} = operation, more, required, except) do
    own = for field <- operation.fields, field.key not in except, field.schema != false, do: field
    properties = for field <- own, into: more, do: {field.key, Field.schema(field)}
    required = required ++ for %{required: true, key: key} <- own, do: key
    Json.Schema.object(properties, required, [open: not closed?(operation)] ++ operation.rules)
  end

  @doc "The name of the schema of its answer."
  @spec answer_name(t()) :: String.t()
  def answer_name(%__MODULE__{name: name, answer_as: as}), do: "answer." <> (as || name)

  @doc "The JSON Schema of its answer, with further properties."
  @spec answer_schema(t(), more :: map()) :: Json.Schema.t()
  def answer_schema(%__MODULE__{answer: answer}, more \\ %{}) do
    answer = if is_list(answer), do: Json.Object.properties(answer), else: answer
    properties = Map.merge(more, answer)
    Json.Schema.object(properties, Map.keys(properties), open: true)
  end
end
