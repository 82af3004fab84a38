defmodule Aerie.Vehicle.State do
  @moduledoc """
  The state of a vehicle, built from its autopilot's messages. A pure value.

  State comes in groups. Each has `at` (unix us), when its last message arrived, `time_boot_ms`, the vehicle's own clock at that
  time (nil if unknown), and `data`. All keys of a group are always present; unknown values are nil. `Aerie.Vehicle.State.Groups`
  lists the groups; the module of each has its fields and reads its messages.

  If several messages carry the same values, the best one is used while it comes (`wants?/3`): a stream of ATTITUDE_QUATERNION
  is not even decoded while ATTITUDE arrives.
  """

  alias Aerie.Vehicle.{Firmware, State}
  alias Aerie.Vehicle.State.Groups
  alias MavCodec.Messages, as: M

  @empty Map.new(Groups.keys(), fn {group, keys} -> {group, Map.from_keys(keys, nil)} end)
  @fresh_us 2_000_000
  # Only these can show that the vehicle left the ground or came back to it.
  @flight Enum.map(
            [
              M.Heartbeat,
              M.LocalPositionNed,
              M.GlobalPositionInt,
              M.Altitude,
              M.HighLatency2,
              M.ExtendedSysState
            ],
            & &1.id()
          )

  defstruct autopilot: :generic,
            type: nil,
            kind: "unknown",
            firmware: nil,
            uid: nil,
            capabilities: nil,
            boot_ms: nil,
            base_mode: nil,
            mode_names: %{},
            standard_modes: %{},
            modes_seq: nil,
            landed: nil,
            quadplane: false,
            liftoff: nil,
            origin: nil,
            high_latency: false,
            gimbal_manager: nil,
            silent_batteries: %{},
            groups: %{},
            sources: %{}

  @typedoc "Degrees, and metres above mean sea level."
  @type place :: %{lat: float(), lon: float(), alt_msl: float() | nil}

  @type group :: atom()
  @type entry :: %{at: integer(), time_boot_ms: non_neg_integer() | nil, data: map()}
  @type t :: %__MODULE__{
          autopilot: Firmware.name(),
          type: integer() | nil,
          kind: String.t(),
          firmware: String.t() | nil,
          uid: String.t() | nil,
          capabilities: non_neg_integer() | nil,
          boot_ms: non_neg_integer() | nil,
          base_mode: integer() | nil,
          mode_names: %{non_neg_integer() => String.t()},
          standard_modes: %{String.t() => non_neg_integer()},
          modes_seq: 0..255 | nil,
          landed: {integer(), at :: integer()} | nil,
          quadplane: boolean(),
          liftoff: State.Liftoff.t() | nil,
          origin: place() | nil,
          high_latency: boolean(),
          gimbal_manager: 0..255 | nil,
          silent_batteries: %{(id :: 0..255) => messages_of_others :: pos_integer()},
          groups: %{group() => entry()},
          sources: %{non_neg_integer() => integer()}
        }

  @doc "The keys of a group's data."
  @spec keys(group()) :: [atom()]
  def keys(group), do: Keyword.fetch!(Groups.keys(), group)

  @doc "Whether a message that came `at` is worth decoding."
  @spec wants?(t(), non_neg_integer(), integer()) :: boolean()
  def wants?(state, id, at) do
    case {Groups.first_choice(id), state.sources} do
      {nil, _sources} -> Groups.reads?(id)
      {first, %{} = sources} when is_map_key(sources, first) -> at - sources[first] > @fresh_us
      _never_heard -> true
    end
  end

  @doc """
  Applies a message of the autopilot that came `at`, and returns the groups that it updated; `{:invalid, field}` for an
  impossible value, which changes nothing.
  """
  @spec apply(t(), non_neg_integer(), struct(), integer()) :: {t(), [group()]} | {:invalid, atom()}
  def apply(state, id, message, at) do
    with {fields, changes} when is_list(fields) <- Groups.reader(id).read(message, state, at) do
      state = %{state | sources: Map.put(state.sources, id, at)}
      state = if fields == [], do: state, else: struct!(state, fields)
      merge_all(changes, state, [], id, at)
    end
  end

  defp merge_all([], state, groups, id, at), do: fly(state, id, Enum.reverse(groups), at)

  defp merge_all([{group, _keys} = change | rest], state, groups, id, at),
    do: merge_all(rest, merge(state, change, at), [group | groups], id, at)

  defp fly(state, id, groups, at) when id in @flight do
    {state, groups} =
      case State.Flight.in_air(state, at) do
        :same -> {state, groups}
        in_air -> {merge(state, {:mode, %{in_air: in_air}}, at), Enum.uniq(groups ++ [:mode])}
      end

    {%{state | liftoff: State.Liftoff.next(state.liftoff, state)}, groups}
  end

  defp fly(state, _id, groups, _at), do: {state, groups}

  @doc "Sets the vehicle's clock."
  @spec at_boot(t(), non_neg_integer()) :: t()
  def at_boot(state, boot_ms), do: %{state | boot_ms: boot_ms}

  @doc "Sets keys of a group that do not come from a message."
  @spec put(t(), group(), map(), integer()) :: t()
  def put(state, group, changes, at), do: merge(state, {group, changes}, at)

  @doc "A group's data; all keys are nil before its first message."
  @spec data(t(), group()) :: map()
  def data(%{groups: groups}, group) do
    case groups do
      %{^group => %{data: data}} -> data
      _unheard -> Map.fetch!(@empty, group)
    end
  end

  @doc "Time goes on from `now`, which is not comparable with the time before: all sources count as heard now."
  @spec rebased(t(), integer()) :: t()
  def rebased(state, now) do
    landed = with {landed_state, _at} <- state.landed, do: {landed_state, now}
    %{state | landed: landed, sources: Map.new(state.sources, fn {id, _at} -> {id, now} end)}
  end

  @doc "The clock was set by `step` (us): everything was heard as long ago as before."
  @spec shifted(t(), integer()) :: t()
  def shifted(state, step) do
    landed = with {landed_state, at} <- state.landed, do: {landed_state, at + step}
    sources = Map.new(state.sources, fn {id, at} -> {id, at + step} end)
    groups = Map.new(state.groups, fn {name, group} -> {name, %{group | at: group.at + step}} end)
    %{state | landed: landed, sources: sources, groups: groups}
  end

  @doc "Whether a MAV_TYPE and a MAV_AUTOPILOT are those of another vehicle."
  @spec other?(t(), integer(), integer()) :: boolean()
  def other?(state, type, autopilot),
    do: type != state.type or Firmware.heard(autopilot, state.autopilot) != state.autopilot

  @doc "The part of a snapshot that only `restore/1` needs."
  @spec memory(t()) :: map()
  def memory(state) do
    # Not Map.take/2: a snapshot is written for nearly each frame.
    %{
      landed: state.landed,
      quadplane: state.quadplane,
      liftoff: state.liftoff,
      origin: state.origin,
      sources: state.sources,
      boot_ms: state.boot_ms,
      high_latency: state.high_latency,
      gimbal_manager: state.gimbal_manager,
      silent_batteries: state.silent_batteries,
      base_mode: state.base_mode,
      mode_names: state.mode_names,
      standard_modes: state.standard_modes,
      modes_seq: state.modes_seq
    }
  end

  @doc "The state that a snapshot shows."
  @spec restore(Aerie.Vehicle.Snapshot.t()) :: t()
  def restore(snapshot) do
    shown = %__MODULE__{
      autopilot: snapshot.autopilot,
      kind: snapshot.vehicle_type,
      firmware: snapshot.firmware,
      uid: snapshot.uid,
      type: snapshot.type,
      capabilities: snapshot.capabilities,
      groups: snapshot.groups
    }

    struct!(shown, snapshot.memory)
  end

  defp merge(state, {group, changes}, at) do
    data = Map.merge(data(state, group), changes)
    %{state | groups: Map.put(state.groups, group, %{at: at, time_boot_ms: state.boot_ms, data: data})}
  end
end
