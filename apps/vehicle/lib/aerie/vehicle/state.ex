defmodule Aerie.Vehicle.State do
  @moduledoc """
  What is known about a vehicle, folded from its autopilot's messages. A pure value.

  State comes in groups, each with the time `at` which its last message arrived (unix us), the vehicle's own clock then
  (`time_boot_ms`, nil when unknown) and `data`. All keys of a group are always there; what is unknown is nil.
  `Aerie.Vehicle.Fields` lists the groups and what is in them.

  Several messages may tell the same; the better one wins while it keeps coming (`wants?/3`), so that a stream of
  ATTITUDE_QUATERNION is not even decoded while ATTITUDE arrives.
  """

  alias Aerie.Vehicle.{Fields, Kind, State}

  @groups Fields.keys()
  @empty Map.new(@groups, fn {group, keys} -> {group, Map.new(keys, &{&1, nil})} end)

  # Message id => the module that knows what it says.
  @handlers %{
    0 => State.Mode,
    245 => State.Mode,
    435 => State.Mode,
    24 => State.Motion,
    30 => State.Motion,
    31 => State.Motion,
    32 => State.Motion,
    33 => State.Motion,
    74 => State.Motion,
    242 => State.Motion,
    1 => State.Power,
    147 => State.Power,
    42 => State.Plan,
    46 => State.Plan,
    62 => State.Plan,
    162 => State.Plan,
    35 => State.Health,
    65 => State.Health,
    148 => State.Health,
    193 => State.Health,
    230 => State.Health,
    241 => State.Health,
    235 => State.HighLatency
  }

  # Second choices: used only while the first has not come for this long.
  @second_choice %{31 => {:attitude, 30}, 32 => {:velocity, 33}, 35 => {:rc, 65}, 230 => {:health, 193}}
  @fresh_us 2_000_000

  defstruct autopilot: :generic,
            type: nil,
            kind: "unknown",
            firmware: nil,
            uid: nil,
            capabilities: nil,
            boot_ms: nil,
            base_mode: nil,
            mode_names: %{},
            landed: nil,
            high_latency: false,
            groups: %{},
            sources: %{}

  @type group :: atom()
  @type entry :: %{at: integer(), time_boot_ms: non_neg_integer() | nil, data: map()}
  @type t :: %__MODULE__{
          autopilot: Kind.autopilot(),
          type: integer() | nil,
          kind: String.t(),
          firmware: String.t() | nil,
          uid: String.t() | nil,
          capabilities: non_neg_integer() | nil,
          boot_ms: non_neg_integer() | nil,
          base_mode: integer() | nil,
          mode_names: %{non_neg_integer() => String.t()},
          landed: {integer(), at :: integer()} | nil,
          high_latency: boolean(),
          groups: %{group() => entry()},
          sources: %{non_neg_integer() => integer()}
        }

  @typedoc "What a message says: fields of the vehicle and changes of groups."
  @type said :: {fields :: keyword(), changes :: [{group(), map()}]} | {:invalid, atom()}

  @doc "What a message says, given what is known already."
  @callback read(message :: struct(), t(), at :: integer()) :: said()

  @doc "The names of all groups."
  @spec groups() :: [group()]
  def groups, do: Keyword.keys(@groups)

  @doc "The keys of a group's data."
  @spec keys(group()) :: [atom()]
  def keys(group), do: Keyword.fetch!(@groups, group)

  @doc "The ids of all messages that say something about the state."
  @spec ids() :: [non_neg_integer()]
  def ids, do: Map.keys(@handlers)

  @doc "Whether a message that came `at` is worth decoding."
  @spec wants?(t(), non_neg_integer(), integer()) :: boolean()
  def wants?(state, id, at) when is_map_key(@second_choice, id) do
    {_group, first} = Map.fetch!(@second_choice, id)

    case state.sources do
      %{^first => heard} -> at - heard > @fresh_us
      _never -> true
    end
  end

  def wants?(_state, id, _at), do: is_map_key(@handlers, id)

  @doc """
  Folds in a message of the autopilot that came `at`. Gives the groups that it renewed; `{:invalid, field}` for a value
  that cannot be, which changes nothing.
  """
  @spec apply(t(), non_neg_integer(), struct(), integer()) :: {t(), [group()]} | {:invalid, atom()}
  def apply(state, id, message, at) do
    with {fields, changes} when is_list(fields) <- Map.fetch!(@handlers, id).read(message, state, at) do
      state = %{state | sources: Map.put(state.sources, id, at)}
      state = if fields == [], do: state, else: struct!(state, fields)
      state = Enum.reduce(changes, state, &merge(&2, &1, at))
      fly(state, id, Keyword.keys(changes), at)
    end
  end

  # Only these can show that the vehicle left the ground or came back to it.
  defp fly(state, id, groups, at) when id in [0, 32, 33, 235, 245] do
    case State.Flight.in_air(state, at) do
      :same -> {state, groups}
      in_air -> {merge(state, {:mode, %{in_air: in_air}}, at), Enum.uniq(groups ++ [:mode])}
    end
  end

  defp fly(state, _id, groups, _at), do: {state, groups}

  @doc "The vehicle's clock as a message told it."
  @spec at_boot(t(), non_neg_integer()) :: t()
  def at_boot(state, boot_ms), do: %{state | boot_ms: boot_ms}

  @doc "Sets keys of a group that do not come from a message."
  @spec put(t(), group(), map(), integer()) :: t()
  def put(state, group, changes, at), do: merge(state, {group, changes}, at)

  @doc "A group's data; all keys nil when nothing was heard."
  @spec data(t(), group()) :: map()
  def data(%{groups: groups}, group) do
    case groups do
      %{^group => %{data: data}} -> data
      _unheard -> Map.fetch!(@empty, group)
    end
  end

  @doc "Time goes on from `now`: what the state goes by counts as heard now."
  @spec rebased(t(), integer()) :: t()
  def rebased(state, now) do
    landed = with {landed_state, _at} <- state.landed, do: {landed_state, now}
    %{state | landed: landed, sources: Map.new(state.sources, fn {id, _at} -> {id, now} end)}
  end

  @doc "The clock was set by `step`: all that was heard was heard as long ago as before."
  @spec shifted(t(), integer()) :: t()
  def shifted(state, step) do
    landed = with {landed_state, at} <- state.landed, do: {landed_state, at + step}
    sources = Map.new(state.sources, fn {id, at} -> {id, at + step} end)
    groups = Map.new(state.groups, fn {name, group} -> {name, %{group | at: group.at + step}} end)
    %{state | landed: landed, sources: sources, groups: groups}
  end

  # What judging the next message takes besides the groups.
  @memory [:landed, :sources, :boot_ms, :high_latency, :base_mode, :mode_names]

  @doc "What a snapshot keeps for `restore/1` besides what it shows."
  @spec memory(t()) :: map()
  def memory(state), do: Map.take(state, @memory)

  @doc "The state that a snapshot of the vehicle shows; what is older than that comes from the wire again."
  @spec restore(map()) :: t()
  def restore(snapshot) do
    shown = %__MODULE__{
      autopilot: snapshot.autopilot,
      kind: snapshot.vehicle_type,
      firmware: snapshot.firmware,
      uid: Map.get(snapshot, :uid),
      type: Map.get(snapshot, :type),
      capabilities: Map.get(snapshot, :capabilities),
      groups: snapshot.groups
    }

    struct!(shown, Map.get(snapshot, :memory, %{}))
  end

  defp merge(state, {group, changes}, at) do
    data = Map.merge(data(state, group), changes)
    %{state | groups: Map.put(state.groups, group, %{at: at, time_boot_ms: state.boot_ms, data: data})}
  end
end
