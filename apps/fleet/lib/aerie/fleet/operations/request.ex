defmodule Aerie.Fleet.Operations.Request do
  @moduledoc """
  An operation as it comes from outside, checked. Pure.

      {"id": "roll-7", "tag": "survey", "command": {"type": "rtl"}, "step": 5, "pause_s": 10, "halt_ratio": 0.2}
      {"vehicles": ["VID-001", "VID-002"], "shadow": {"desired": {"params": {"FENCE_ALT_MAX": 80}}}, "await": "converged"}

  Of `vehicles` and `tag`, and of `command` and `shadow`, exactly one must be there. Without `timeout_s` a shadow has 60
  seconds, 5 more for each field and 600 for a plan, and a command 10. `fields/0` has the rest.
  """

  import Aerie.Base.Json.Schema, only: [number: 2, ref: 1, token: 0]
  import Aerie.Base.Settings.Field, only: [field: 4]

  alias Aerie.Base.Settings.Field
  alias Aerie.Control.Operations.Operation
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Error
  alias Aerie.Fleet.Shadow.Update

  @max_vehicles 2_000
  @id "1 to 32 letters, digits, - and _"
  @longest %{command: 300, shadow: 3_600}

  @enforce_keys [:id, :targets, :what, :plan, :timeout_ms]
  defstruct [:id, :targets, :what, :plan, :timeout_ms, await: :written]

  @type t :: %__MODULE__{
          id: String.t(),
          targets: {:vehicles, [String.t(), ...]} | {:tag, String.t()},
          what: {:command, String.t(), map()} | {:shadow, map()},
          plan: %{step: pos_integer(), pause_ms: non_neg_integer(), halt_ratio: float()},
          timeout_ms: pos_integer(),
          await: :written | :converged
        }

  @doc "The most vehicles of one operation."
  @spec max_vehicles() :: pos_integer()
  def max_vehicles, do: @max_vehicles

  @doc "The longest `timeout_s` of a command or shadow."
  @spec longest_s(:command | :shadow) :: pos_integer()
  def longest_s(what), do: Map.fetch!(@longest, what)

  @doc "The fields of a request. What is asked for is checked by those that do it."
  @spec fields() :: [Field.t()]
  def fields do
    most = %{type: :array, minItems: 1, maxItems: @max_vehicles, items: token()}
    id = %{type: :string, pattern: "^[A-Za-z0-9_-]{1,32}$"}
    any = fn words -> {:term, &{:ok, &1}, words} end

    [
      field(:id, {:term, &id/1, @id}, "the same id is the same operation; one is made if left out",
        schema: id
      ),
      field(:vehicles, {:term, &vehicles/1, "a list of 1 to #{@max_vehicles} ids"}, "which ones",
        schema: most
      ),
      field(:tag, {:text, 1, 64}, "all vehicles that have it when the operation begins", []),
      field(:command, any.("an object with a type"), "a command's type and params",
        schema: ref("command_of_operation")
      ),
      field(:shadow, any.("an object"), "a change of the desired state, without its version",
        schema: ref("change_of_operation")
      ),
      field(:step, {:integer, 1, 100}, "how many at once", default: 20),
      field(:pause_s, {:number, 0, 3_600}, "between two steps", default: 0, unit: "s"),
      field(:halt_ratio, {:number, 0, 1}, "the share of failures beyond which no more begin; 1: all begin",
        default: 1
      ),
      field(:await, {:enum, [:written, :converged]}, "what a shadow waits for", default: :written),
      field(
        :timeout_s,
        {:number, 1, @longest.shadow},
        "how long a vehicle may take to converge, or a command until it is sent",
        unit: "s",
        schema: number(1, @longest.shadow)
      )
    ]
  end

  defp id(<<id::binary>>) when byte_size(id) <= 32, do: if(Command.token?(id), do: {:ok, id}, else: :error)
  defp id(_other), do: :error

  defp vehicles([_ | _] = ids) when length(ids) <= @max_vehicles,
    do: if(Enum.all?(ids, &(is_binary(&1) and Command.token?(&1))), do: {:ok, Enum.uniq(ids)}, else: :error)

  defp vehicles(_other), do: :error

  @doc "Reads an operation at `now` (unix microseconds), or says all that is wrong with it."
  @spec parse(term(), now :: integer()) :: {:ok, t()} | {:error, [Error.t(), ...]}
  def parse(%{} = object, now) do
    {got, errors} = Operation.read(fields(), object, closed?: true)
    which = one_of(object, "vehicles", "tag") ++ one_of(object, "command", "shadow")
    {what, wrong} = if which == [], do: what(object, now), else: {nil, which}

    errors = errors ++ wrong ++ await(object) ++ timeout_s(object)

    case Enum.uniq_by(errors, & &1.key) do
      [] ->
        {:ok,
         %__MODULE__{
           id: got.id || Command.id(),
           targets: if(got.tag, do: {:tag, got.tag}, else: {:vehicles, got.vehicles}),
           what: what,
           plan: %{step: got.step, pause_ms: round(got.pause_s * 1000), halt_ratio: got.halt_ratio / 1},
           timeout_ms: round((got.timeout_s || usual_s(what)) * 1000),
           await: got.await
         }}

      errors ->
        {:error, errors}
    end
  end

  def parse(other, _now), do: {:error, [Error.new("operation", "an object", other)]}

  defp one_of(object, first, second) do
    case {is_map_key(object, first), is_map_key(object, second)} do
      {true, true} -> [Error.new(second, "either #{first} or #{second}", :rule)]
      {false, false} -> [Error.new(first, "#{first} or #{second}", :missing)]
      _one -> []
    end
  end

  defp what(%{"command" => %{"params" => params}}, _now) when params != nil and not is_map(params),
    do: {nil, [Error.new("command.params", "an object", params)]}

  # As a command for a vehicle that any name may be; each is parsed again with its own.
  defp what(%{"command" => %{"type" => type} = command}, _now) do
    params = Map.get(command, "params") || %{}

    with [] <- Map.keys(command) -- ["type", "params"],
         {:ok, _command} <- Command.new(vehicle: "V", type: type, params: params) do
      {{:command, type, params}, []}
    else
      {:error, errors} -> {nil, below("command", errors)}
      [key | _more] -> {nil, [Error.new("command." <> Error.key(key), "only type and params", :unknown)]}
    end
  end

  defp what(%{"command" => other}, _now), do: {nil, [Error.new("command", "an object with a type", other)]}

  defp what(%{"shadow" => %{"version" => _one}}, _now),
    do: {nil, [Error.new("shadow.version", "no version: each vehicle has another", :rule)]}

  defp what(%{"shadow" => shadow}, now) do
    case Update.parse(shadow, now) do
      {:ok, _update} -> {{:shadow, shadow}, []}
      {:error, errors} -> {nil, below("shadow", errors)}
    end
  end

  defp below(key, errors), do: for(error <- errors, do: %{error | key: key <> "." <> error.key})

  defp await(%{"await" => _any, "command" => _given}),
    do: [Error.new("await", "nothing: a command has its own end", :rule)]

  defp await(_object), do: []

  defp timeout_s(%{"timeout_s" => seconds, "command" => _given})
       when is_number(seconds) and seconds > @longest.command and seconds <= @longest.shadow,
       do: [Error.new("timeout_s", "a number from 1 to #{@longest.command}", seconds)]

  defp timeout_s(_object), do: []

  # By a slow radio a field takes seconds, and a plan minutes.
  defp usual_s({:command, _type, _params}), do: 10

  defp usual_s({:shadow, %{"desired" => desired}}) do
    fields = for {_name, value} <- desired, do: if(is_map(value), do: map_size(value), else: 1)
    plans = Enum.count(desired, fn {_name, value} -> is_map(value) and is_map_key(value, "plan") end)
    min(60 + 5 * Enum.sum(fields) + 600 * plans, @longest.shadow)
  end
end
