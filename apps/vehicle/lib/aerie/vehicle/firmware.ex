defmodule Aerie.Vehicle.Firmware do
  @moduledoc """
  The firmwares that Aerie knows. What is particular to one is in the folder of its name, `firmware/NAME`. To add one,
  write that folder and add its adapter (`Aerie.Vehicle.Firmware.Adapter`) to the list in this file.
  """

  alias Aerie.Vehicle.Firmware.{GroundStation, Modes, Reading, Telemetry, Traits, Unknown}

  @typedoc "A firmware by the name that state, NATS and REST have; `:generic` for any that is not in the list."
  @type name :: atom()

  # In the order of the documentation.
  defp adapters do
    [
      ardupilot: __MODULE__.Ardupilot.Adapter,
      px4: __MODULE__.Px4.Adapter,
      betaflight: __MODULE__.Betaflight.Adapter,
      inav: __MODULE__.Inav.Adapter
    ]
  end

  @doc "The names of all firmwares."
  @spec names() :: [name(), ...]
  def names, do: Keyword.keys(adapters())

  @doc "Whether a firmware is one of these."
  @spec known?(name() | nil) :: boolean()
  def known?(name), do: name in names()

  @doc "What may stand for a firmware in texts, with what it means."
  @spec by_text() :: %{String.t() => name()}
  def by_text, do: Map.new([:generic | names()], &{Atom.to_string(&1), &1})

  @doc "The adapter of a firmware, that of an unknown one for any other name and for nil."
  @spec of(name() | nil) :: module()
  def of(name), do: Keyword.get(adapters(), name, Unknown)

  @doc "What a firmware is and what it offers."
  @spec traits(name() | nil) :: Traits.t()
  def traits(name), do: of(name).traits()

  @doc "Where the messages of a firmware say other things than MAVLink declares."
  @spec telemetry(name() | nil) :: Telemetry.t()
  def telemetry(name), do: of(name).telemetry()

  @doc "How a firmware reads what is sent to it."
  @spec reading(name() | nil) :: Reading.t()
  def reading(name), do: of(name).reading()

  @doc "The modules of what channels and buttons do, of all firmwares that have one."
  @spec inputs() :: [module(), ...]
  def inputs, do: modules(:inputs)

  @doc "The modules of the room that a firmware takes on its way: its own, or those of all others if it has none."
  @spec rooms(name() | nil) :: [module(), ...]
  def rooms(name), do: if(room = traits(name).room, do: [room], else: modules(:room))

  defp modules(key),
    do: for({_name, adapter} <- adapters(), module = Map.fetch!(adapter.traits(), key), do: module)

  @doc "Which ground station keeps the failsafe of a firmware on a kind of vehicle quiet."
  @spec ground_station(name() | nil, kind :: String.t()) :: GroundStation.t()
  def ground_station(name, kind), do: of(name).ground_station(kind)

  @doc "The modes of a vehicle (its snapshot) that can be requested: its firmware's, and those that it reported itself."
  @spec modes(map()) :: [String.t()]
  def modes(%{autopilot: firmware, vehicle_type: kind, memory: memory}),
    do: Modes.all(firmware, kind) ++ Enum.sort(Map.values(memory[:mode_names] || %{}))

  @doc "The mode to be set first, if a vehicle refuses to be armed in this one; nil if it does not, or tells by itself."
  @spec arm_first(map(), mode :: String.t() | nil) :: String.t() | nil
  def arm_first(%{autopilot: firmware, vehicle_type: kind}, mode), do: Modes.arm_first(firmware, kind, mode)

  @doc "What a vehicle does by itself in a mode; nil for one in which a pilot flies, and one that is not known."
  @spec action(mode :: String.t() | nil) :: Modes.Action.t() | nil
  defdelegate action(mode), to: Modes.Action, as: :of

  @doc "What a vehicle does in a mode, in one or two words, whatever its firmware calls it: `Hold` for AUTO_LOITER."
  @spec meaning(mode :: String.t() | nil) :: String.t() | nil
  def meaning(mode), do: if(action = action(mode), do: Modes.Action.word(action))

  @doc """
  The mode in which a vehicle (its snapshot) does this by itself; nil if it has none. Holding, returning and landing are
  commands of their own, for which each firmware has its way.
  """
  @spec mode_for(map(), Modes.Action.t()) :: String.t() | nil
  def mode_for(vehicle, action), do: Modes.Action.among(action, modes(vehicle))

  @doc "The name of a firmware for people."
  @spec title(name()) :: String.t()
  def title(name), do: traits(name).title

  @doc """
  The firmware of a heartbeat's MAV_AUTOPILOT. One without a number there says that it is generic, and stays what it is
  known to be.
  """
  @spec heard(integer(), known :: name()) :: name()
  def heard(number, known \\ :generic) do
    with :generic <- find(&(&1.mav_autopilot == number)),
         do: if(traits(known).vendor, do: known, else: :generic)
  end

  @doc "The firmware of a vendor's name in COMPONENT_INFORMATION_BASIC; `:generic` for another one."
  @spec vendor(String.t()) :: name()
  def vendor(name), do: find(&(&1.vendor == name))

  defp find(fits?) do
    Enum.find_value(adapters(), :generic, fn {name, adapter} -> if fits?.(adapter.traits()), do: name end)
  end
end
