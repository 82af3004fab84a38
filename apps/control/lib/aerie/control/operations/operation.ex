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
    * `:changes?` - it changes the vehicle: it is carried out like a command, so it may have an id, and its answer is
      a result
    * `:fields` - its own; every operation has those of `common/0` as well
    * `:rules` - further keywords of the request's JSON Schema, for what fields cannot say; `c:run/2` checks them
    * `:answer` - the properties of what `c:run/2` reads
    * `:routes` - how it is asked for over REST
  """

  alias Aerie.Base.{JsonSchema, Names}
  alias Aerie.Base.Settings.{Field, Schema}
  alias Aerie.Control.Operations.Route
  alias Aerie.Control.Transfers
  alias Aerie.Vehicle.Command.{Error, Result}

  @enforce_keys [:name, :meaning]
  defstruct [:module, :name, :meaning, changes?: false, fields: [], rules: [], answer: %{}, routes: []]

  @type t :: %__MODULE__{
          module: module() | nil,
          name: String.t(),
          meaning: String.t(),
          changes?: boolean(),
          fields: [Field.t()],
          rules: keyword(),
          answer: %{atom() => JsonSchema.t()},
          routes: [Route.t()]
        }

  @typedoc "The fields by their names, with their defaults; nil for one that was left out."
  @type input :: %{atom() => term()}

  @typedoc """
    * `:options` - `t:Aerie.Control.Transfers.option/0`
    * `:format` - the form of a file that is read or sent (`Aerie.Control.Operations.Route`); `"json"` unless REST
      chose another
    * `:max_bytes` - the most that an answer can have; nil: whatever the operation allows
  """
  @type context :: %{
          gateway: Names.gateway(),
          vehicle: String.t(),
          options: [Transfers.option()],
          format: String.t(),
          max_bytes: pos_integer() | nil
        }

  @typedoc "`:file` is the text of a file in the context's format, `:bytes` one of any kind."
  @type answer ::
          {:ok,
           map() | {:file, name :: String.t(), iodata()} | {:bytes, iodata(), name :: String.t()} | Result.t()}
          | {:pending, id :: String.t()}
          | {:error, Result.t() | [Error.t(), ...] | {:invalid, String.t()}}

  @callback operation() :: t()
  @doc """
  Reads what costs more than a message, such as a plan, in the format in which it came. Pure, so that an interface can
  do it within its limits. `{:invalid, reason}` concerns the file as a whole.
  """
  @callback prepare(input(), format :: String.t()) ::
              {:ok, input()} | {:error, [Error.t(), ...] | {:invalid, String.t()}}
  @optional_callbacks prepare: 2
  @callback run(input(), context()) :: answer()

  defmacro __using__(_options) do
    quote do
      @behaviour Aerie.Control.Operations.Operation

      import Aerie.Base.JsonSchema
      import Aerie.Control.Operations.Fields
      import Aerie.Control.Operations.Route, only: [get: 2, get: 3, put: 3, delete: 2, delete: 3]

      alias Aerie.Control.Operations.Operation
    end
  end

  @max_errors 8
  # Shorter than a connection's time-out.
  @max_wait_s 20

  @doc """
  Reads a request: a map with text keys, whose values are those of JSON, or `{:text, text}` where everything is text.
  null is the same as nothing. Options:

    * `:more` - fields of the interface; `:required` - names of fields that must be there as well
    * `:file` - `{field, bytes}`, a field that came as a file in the `:format`
  """
  @spec parse(t(), map(), keyword()) :: {:ok, input()} | {:error, [Error.t(), ...] | {:invalid, String.t()}}
  def parse(%__MODULE__{} = operation, given, options \\ []) do
    format = Keyword.get(options, :format, "json")
    {file, bytes} = Keyword.get(options, :file, {nil, nil})
    required = Keyword.get(options, :required, [])

    fields =
      for field <- common() ++ operation.fields ++ Keyword.get(options, :more, []), field.key != file do
        %{field | required: field.required or field.key in required}
      end

    known = Enum.map(fields, &Field.name/1)
    {given, unknown} = given |> Map.reject(fn {_key, value} -> value == nil end) |> Map.split(known)

    case Schema.validate(fields, given) do
      {input, []} when unknown == %{} ->
        prepare(operation.module, if(file, do: Map.put(input, file, bytes), else: input), format)

      {_input, problems} ->
        {:error, Enum.take(Enum.map(problems, &error/1) ++ unknown(unknown, known), @max_errors)}
    end
  end

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
    %Error{key: key, expected: problem.expected, got: problem.got}
  end

  @doc "The fields that every operation has."
  @spec common() :: [Field.t()]
  def common do
    [
      Field.field(:id, :token, "the same id is the same request; progress is published with it"),
      Field.field(:timeout, {:number, 0.001, Transfers.max_timeout_s()}, "how long it may take", unit: "s")
    ]
  end

  @doc "How long REST waits for the result of a change."
  @spec wait() :: Field.t()
  def wait do
    meaning = "how long to wait for the result; then 202, and the change goes on"
    Field.field(:wait, {:integer, 0, @max_wait_s}, meaning, default: @max_wait_s, unit: "s")
  end

  @doc "The options of `Aerie.Control.Transfers` in a request that was read."
  @spec options(input()) :: keyword()
  def options(input) do
    for {key, value} <- [
          component: input[:component],
          id: input.id,
          timeout_ms: input.timeout && ceil(input.timeout * 1000),
          wait_ms: input[:wait] && input.wait * 1000
        ],
        value != nil,
        do: {key, value}
  end

  @doc "The JSON Schema of a request with its own fields (without `except`) and `more` properties."
  @spec schema(t(), more :: map(), required :: [atom()], except :: [atom()]) :: JsonSchema.t()
  def schema(%__MODULE__{} = operation, more, required, except \\ []) do
    own = for field <- operation.fields, field.key not in except, field.schema != false, do: field
    properties = for field <- own, into: more, do: {field.key, Field.schema(field)}
    required = required ++ for %{required: true, key: key} <- own, do: key
    JsonSchema.object(properties, required, operation.rules)
  end

  @doc "The JSON Schema of what it reads, with further properties."
  @spec answer_schema(t(), more :: map()) :: JsonSchema.t()
  def answer_schema(%__MODULE__{answer: answer}, more \\ %{}) do
    properties = Map.merge(more, answer)
    JsonSchema.object(properties, Map.keys(properties), open: true)
  end
end
