defmodule Aerie.Vehicle.Services.Switches do
  @moduledoc """
  The parameters of a vehicle on which rules of the policy and adapters depend: what its mode switch, channels and
  buttons do (`Aerie.Vehicle.Firmware.Inputs`), whether and for how long it obeys overrides and set-points, and how wide
  its paths are (`Aerie.Vehicle.Firmware.Room`). A pure value.

  They are read once, a few at a time, after those of `Aerie.Vehicle.Services.Gcs`, and again after a reboot; any other
  PARAM_VALUE that comes is used as well.
  """

  alias Aerie.Vehicle.Firmware
  alias MavCodec.Messages.ParamRequestRead

  @first_us 15_000_000
  @pause_us 1_000_000
  @at_once 4
  @tries 2

  @shaping for row <- MavCodec.Meaning.Shaping.all(), row.metres != nil, do: row.name

  defstruct params: %{}, asked: %{}, next: nil

  @typedoc "`:asked` - how often each was requested since the vehicle's boot; `:next` - when the next ones are due."
  @type t :: %__MODULE__{
          params: %{String.t() => number()},
          asked: %{String.t() => pos_integer()},
          next: integer() | nil
        }

  @doc "Nothing known, or what a snapshot's `params` shows."
  @spec new(map() | nil) :: t()
  def new(params \\ nil), do: %__MODULE__{params: params || %{}}

  @doc "The value of any parameter."
  @spec param(t(), String.t(), number()) :: t()
  def param(switches, name, value) do
    if name in @shaping or Enum.any?(Firmware.inputs(), & &1.keeps?(name)),
      do: %{switches | params: Map.put(switches.params, name, value)},
      else: switches
  end

  @doc "After a reboot they are read again: they may have been changed before it."
  @spec rebooted(t(), integer()) :: t()
  def rebooted(_switches, at), do: %__MODULE__{next: at + @first_us}

  @doc "Time goes on from `now`, which is not comparable with the time before."
  @spec rebased(t(), integer()) :: t()
  def rebased(switches, now), do: %{switches | next: switches.next && now + @pause_us}

  @doc "The clock was set by `step` (us)."
  @spec shifted(t(), integer()) :: t()
  def shifted(switches, step), do: %{switches | next: switches.next && switches.next + step}

  @doc "The requests that are due at `now` to a vehicle of a firmware and a kind."
  @spec due(t(), integer(), target :: {integer(), integer()}, firmware :: {atom(), String.t()}) ::
          {t(), [%ParamRequestRead{}]}
  def due(%{next: nil} = switches, now, _target, _firmware), do: {%{switches | next: now + @first_us}, []}
  def due(%{next: next} = switches, now, _target, _firmware) when now < next, do: {switches, []}

  def due(switches, now, {system, component}, firmware) do
    wanted =
      firmware
      |> plan()
      |> Enum.filter(&(not is_map_key(switches.params, &1) and Map.get(switches.asked, &1, 0) < @tries))
      |> Enum.take(@at_once)

    asked = Enum.reduce(wanted, switches.asked, fn name, asked -> Map.update(asked, name, 1, &(&1 + 1)) end)
    request = %ParamRequestRead{target_system: system, target_component: component, param_index: -1}
    {%{switches | asked: asked, next: now + @pause_us}, for(name <- wanted, do: %{request | param_id: name})}
  end

  @doc "The parameters that are read from a vehicle of a firmware and a kind."
  @spec plan(firmware :: {Firmware.name(), String.t()}) :: [String.t()]
  def plan({firmware, kind}) do
    %{inputs: inputs, room: room} = Firmware.traits(firmware)
    for module <- [inputs, room], module != nil, name <- module.params(kind), do: name
  end
end
