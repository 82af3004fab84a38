defmodule Aerie.Fleet.Operations.Request do
  @moduledoc """
  An operation as it comes from outside, checked. Pure.

      {"id": "roll-7", "tag": "survey", "command": {"type": "rtl"}, "step": 5, "pause_s": 10, "halt_ratio": 0.2}
      {"vehicles": ["VID-001"], "shadow": {"desired": {"params": {"FENCE_ALT_MAX": 80}}}, "await": "converged"}
      {"name": "Take off", "sequence": [{"vehicle": "VID-001", "steps": [{"type": "arm"}, …]}, …], "pause_s": 6}

  Of `command`, `shadow` and `sequence` (`Aerie.Fleet.Operations.Sequence`) exactly one must be there, and of
  `vehicles` and `tag` with the first two. Without `timeout_s` a shadow has 60 seconds, 5 more for each field and 600
  for a plan, and a command 10. `fields/0` has the rest.
  """

  import Aerie.Base.Json.Schema, only: [number: 2, ref: 1, token: 0]
  import Aerie.Base.Settings.Field, only: [field: 4]

  alias Aerie.Base.Settings.Field
  alias Aerie.Control.Operations.Operation
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Error
  alias Aerie.Fleet.Operations.Sequence

  @max_vehicles 2_000
  @id "1 to 32 letters, digits, - and _"
  @max_bytes 1_000_000
  @longest %{command: 300, shadow: 3_600, sequence: 3_600}
  # The keys that not every kind of operation has.
  @own %{
    command: [:command, :vehicles, :tag],
    shadow: [:shadow, :vehicles, :tag, :await],
    sequence: [:sequence, :await, :on_halt, :radius_m]
  }
  @some @own |> Map.values() |> Enum.concat() |> Enum.uniq()
  # A sequence begins with the next vehicle only, and ends at the first failure.
  @sequence %{step: 1, halt_ratio: 0}
  @readiness ~w(ready check unknown not_ready)
  @seen "an object: for each of at most #{@max_vehicles} vehicles one of #{Enum.join(@readiness, ", ")}"

  @enforce_keys [:id, :targets, :what, :plan, :timeout_ms]
  defstruct [:id, :targets, :what, :plan, :timeout_ms, :name, await: :written, on_halt: :hold, radius_m: 1.5] ++
              [shown: %{}]

  @type t :: %__MODULE__{
          id: String.t(),
          targets: {:vehicles, [String.t(), ...]} | {:tag, String.t()},
          what: {:command, String.t(), map()} | {:shadow, map()} | {:sequence, [Sequence.vehicle(), ...]},
          plan: %{step: pos_integer(), pause_ms: non_neg_integer(), halt_ratio: float()},
          timeout_ms: pos_integer() | nil,
          name: String.t() | nil,
          await: :written | :converged,
          on_halt: :hold | :return,
          radius_m: float(),
          shown: %{String.t() => String.t()}
        }

  @doc "The most vehicles of one operation."
  @spec max_vehicles() :: pos_integer()
  def max_vehicles, do: @max_vehicles

  @doc "The most bytes of a request."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc "The fields of a kind of operation, with the defaults and limits that they have there."
  @spec fields(:command | :shadow | :sequence) :: [Field.t()]
  def fields(kind) do
    for field <- fields(), field.key not in @some or field.key in @own[kind] do
      field = if field.key == :timeout_s, do: %{field | schema: number(1, @longest[kind])}, else: field
      if kind == :sequence, do: %{field | default: Map.get(@sequence, field.key, field.default)}, else: field
    end
  end

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
      field(
        :sequence,
        any.("a list of vehicles with their steps"),
        "each vehicle with steps of its own, in their order",
        schema: Sequence.schema(@max_vehicles)
      ),
      field(:name, {:text, 1, 64}, "what it is called on the pages", []),
      field(:step, {:integer, 1, 100}, "how many at once", default: 20),
      field(:pause_s, {:number, 0, 3_600}, "between two steps", default: 0, unit: "s"),
      field(:halt_ratio, {:number, 0, 1}, "the share of failures beyond which no more begin; 1: all begin",
        default: 1
      ),
      field(
        :on_halt,
        {:enum, [:hold, :return]},
        "return: when more fail than halt_ratio, those that have begun return",
        default: :hold
      ),
      field(
        :radius_m,
        {:number, 0, 100},
        "the room of a vehicle: it does not take off when another one stands nearer than twice this",
        default: 1.5,
        unit: "m"
      ),
      field(
        :shown,
        {:term, &shown/1, @seen},
        "the readiness that was shown of each vehicle: begins only if it still holds",
        schema: %{
          type: :object,
          maxProperties: @max_vehicles,
          propertyNames: token(),
          additionalProperties: %{enum: @readiness}
        }
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

  defp shown(%{} = words) when map_size(words) <= @max_vehicles do
    if Enum.all?(words, fn {id, word} -> Command.token?(id) and word in @readiness end),
      do: {:ok, words},
      else: :error
  end

  defp shown(_other), do: :error

  @doc "Reads an operation at `now` (unix microseconds), or says all that is wrong with it."
  @spec parse(term(), now :: integer()) :: {:ok, t()} | {:error, [Error.t(), ...]}
  def parse(%{} = object, now) do
    {got, errors} = Operation.read(fields(), object, closed?: true)
    {what, wrong} = with {:ok, kind} <- kind(object), do: what(kind, object, now)
    errors = errors ++ wrong ++ timeout_s(what, object)

    case Enum.uniq_by(errors, & &1.key) do
      [] ->
        got = if object["sequence"], do: defaults(got, object), else: got

        {:ok,
         %__MODULE__{
           id: got.id || Command.id(),
           targets: targets(what, got),
           what: what,
           plan: %{step: got.step, pause_ms: round(got.pause_s * 1000), halt_ratio: got.halt_ratio / 1},
           timeout_ms: timeout_ms(what, got.timeout_s),
           name: got.name,
           await: got.await,
           on_halt: got.on_halt,
           radius_m: got.radius_m / 1,
           shown: got.shown || %{}
         }}

      errors ->
        {:error, errors}
    end
  end

  def parse(other, _now), do: {:error, [Error.new("operation", "an object", other)]}

  defp defaults(got, object),
    do: Map.merge(got, Map.reject(@sequence, fn {key, _value} -> object[Atom.to_string(key)] != nil end))

  defp targets({:sequence, vehicles}, _got), do: {:vehicles, for(%{vehicle: id} <- vehicles, do: id)}
  defp targets(_what, %{tag: nil, vehicles: ids}), do: {:vehicles, ids}
  defp targets(_what, %{tag: tag}), do: {:tag, tag}

  # Which kind it is, or what speaks against it.
  defp kind(%{"sequence" => _list} = object) do
    case for(
           {key, _value} <- object,
           key in ~w(command shadow),
           do: Error.new(key, "nothing beside a sequence", :rule)
         ) do
      [] -> {:ok, :sequence}
      errors -> {nil, errors}
    end
  end

  defp kind(object) do
    case one_of(object, "vehicles", "tag") ++ one_of(object, "command", "shadow") do
      [] -> {:ok, if(is_map_key(object, "command"), do: :command, else: :shadow)}
      errors -> {nil, errors}
    end
  end

  defp one_of(object, first, second) do
    case {is_map_key(object, first), is_map_key(object, second)} do
      {true, true} -> [Error.new(second, "either #{first} or #{second}", :rule)]
      {false, false} -> [Error.new(first, "#{first} or #{second}", :missing)]
      _one -> []
    end
  end

  defp what(kind, object, now) do
    foreign =
      for key <- @some -- @own[kind],
          name = Atom.to_string(key),
          is_map_key(object, name),
          do: Error.new(name, "nothing: a #{kind} does not have it", :rule)

    case read(kind, object, now) do
      {:ok, what} -> {what, foreign}
      {:error, errors} -> {nil, foreign ++ errors}
    end
  end

  defp read(:command, %{"command" => %{"type" => _type} = command}, now),
    do: Sequence.step(command, "command", now)

  defp read(:command, %{"command" => %{"params" => _any} = command}, now),
    do: Sequence.step(Map.put(command, "type", nil), "command", now)

  defp read(:command, object, _now),
    do: {:error, [Error.new("command", "an object with a type", object["command"])]}

  defp read(:shadow, object, now), do: Sequence.shadow(object["shadow"], "shadow", now)

  defp read(:sequence, object, now) do
    with {:ok, vehicles} <- Sequence.parse(object["sequence"], @max_vehicles, now),
         do: {:ok, {:sequence, vehicles}}
  end

  defp timeout_s({:command, _type, _params}, %{"timeout_s" => seconds})
       when is_number(seconds) and seconds > @longest.command and seconds <= @longest.shadow,
       do: [Error.new("timeout_s", "a number from 1 to #{@longest.command}", seconds)]

  defp timeout_s(_what, _object), do: []

  @doc "The time of a step, if the request does not say: in milliseconds."
  @spec usual_ms(Sequence.step()) :: pos_integer()
  def usual_ms(step), do: round(usual_s(step) * 1000)

  # In a sequence each step has its own.
  defp timeout_ms({:sequence, _vehicles}, nil), do: nil
  defp timeout_ms(what, nil), do: usual_ms(what)
  defp timeout_ms(_what, seconds), do: round(seconds * 1000)

  # By a slow radio a field takes seconds, and a plan minutes.
  defp usual_s({:command, _type, _params}), do: 10

  defp usual_s({:shadow, %{"desired" => desired}}) do
    fields = for {_name, value} <- desired, do: if(is_map(value), do: map_size(value), else: 1)
    plans = Enum.count(desired, fn {_name, value} -> is_map(value) and is_map_key(value, "plan") end)
    min(60 + 5 * Enum.sum(fields) + 600 * plans, @longest.shadow)
  end
end
