defmodule Aerie.Vehicle.Firmware.Modes do
  @moduledoc """
  Flight modes by name, both ways, for ArduPilot and PX4.

  ArduPilot numbers its modes per firmware (`Aerie.Vehicle.Firmware.Ardupilot.Modes`), PX4 packs a main and a sub mode into the
  number (`Aerie.Vehicle.Firmware.Px4.Modes`), other firmwares have only the flags of the heartbeat. A number without a name is shown as
  `MODE(27)` and converts back to the same number.
  """

  import Bitwise

  alias Aerie.Vehicle.Firmware.{Ardupilot, Px4}
  alias Aerie.Vehicle.Protocol.Vehicle

  # MAV_MODE_FLAG
  @custom 0x01
  @auto 0x04
  @guided 0x08
  @stabilize 0x10
  @manual 0x40

  @type autopilot :: Aerie.Vehicle.Kind.autopilot()

  @doc "The name of the mode that a heartbeat shows."
  @spec name(autopilot(), String.t(), base_mode :: integer(), custom_mode :: integer()) :: String.t()
  def name(:ardupilot, kind, _base_mode, mode),
    do: Map.get(Ardupilot.Modes.names(kind), mode) || unknown(mode)

  def name(:px4, _kind, base_mode, mode) when band(base_mode, @custom) != 0 or mode != 0 do
    Px4.Modes.name(mode) || unknown(mode)
  end

  def name(_generic, _kind, base_mode, mode) do
    cond do
      band(base_mode, @auto) != 0 -> "AUTO"
      band(base_mode, @guided) != 0 -> "GUIDED"
      band(base_mode, @stabilize) != 0 -> "STABILIZE"
      band(base_mode, @manual) != 0 -> "MANUAL"
      band(base_mode, @custom) != 0 -> unknown(mode)
      true -> "PREFLIGHT"
    end
  end

  @doc """
  The number of a mode's name, whose case does not matter; `MODE(27)` is 27. `:error` if this firmware has no such mode.
  """
  @spec number(autopilot(), String.t(), String.t()) :: {:ok, non_neg_integer()} | :error
  def number(autopilot, kind, name) do
    name = String.upcase(name)

    with :error <- by_name(autopilot, kind, name),
         [_, digits] <- Regex.run(~r/\AMODE\((\d{1,10})\)\z/, name),
         number = String.to_integer(digits),
         nil <- wrong(autopilot, number) do
      {:ok, number}
    else
      {:ok, number} -> {:ok, number}
      _no_mode -> :error
    end
  end

  @doc """
  The modes for which a firmware may take a request (SET_MODE, DO_SET_MODE), its own name for it first, or why the number
  cannot be one: ArduPilot keeps one byte of it, and PX4 takes no notice of its lower half.
  """
  @spec asked(autopilot(), String.t(), base_mode :: integer(), custom_mode :: integer()) ::
          [String.t(), ...] | {:error, String.t()}
  def asked(autopilot, kind, base, custom) do
    case wrong(autopilot, custom) do
      nil -> Enum.uniq(asked(autopilot, kind, base, custom, band(base, @custom) != 0))
      reason -> {:error, reason}
    end
  end

  defp asked(:ardupilot, kind, _base, custom, true), do: [name(:ardupilot, kind, @custom, custom)]
  # It refuses what is not a mode of its own; older ones had modes for the flags.
  defp asked(:ardupilot, _kind, base, _custom, false), do: [name(:generic, "", base, 0)]

  defp asked(:px4, kind, _base, custom, true) do
    case {Px4.Modes.name(custom), Px4.Modes.effect(custom)} do
      {nil, [_ | _] = effect} -> effect
      {_named, effect} -> [name(:px4, kind, @custom, custom) | effect]
    end
  end

  # Without the flag it goes by the others, and the number does not count.
  defp asked(:px4, _kind, base, 0, false), do: [flags(base)]
  defp asked(:px4, kind, base, custom, false), do: [flags(base), name(:px4, kind, @custom, custom)]
  defp asked(_generic, _kind, base, custom, true), do: [name(:generic, "", base, custom), unknown(custom)]
  defp asked(_generic, _kind, base, _custom, false), do: [name(:generic, "", base, 0)]

  # PX4's reading of the flags.
  defp flags(base) do
    cond do
      band(base, @auto) != 0 -> "AUTO_MISSION"
      band(base, @manual) == 0 -> "PREFLIGHT"
      band(base, @guided) != 0 -> "POSCTL"
      band(base, @stabilize) != 0 -> "STABILIZED"
      true -> "MANUAL"
    end
  end

  defp wrong(:ardupilot, mode) when mode not in 0..255, do: "the mode #{mode} is not an integer from 0 to 255"

  defp wrong(:px4, mode) when mode not in 0..0xFFFFFFFF or band(mode, 0xFFFF) != 0,
    do: "the mode #{mode} is not a main mode and a sub mode of PX4"

  defp wrong(_autopilot, _mode), do: nil

  @doc "The names of all modes that can be requested, in the order of their numbers."
  @spec all(autopilot(), String.t()) :: [String.t()]
  def all(:ardupilot, kind), do: kind |> Ardupilot.Modes.names() |> Enum.sort() |> Enum.map(&elem(&1, 1))
  def all(:px4, _kind), do: Px4.Modes.all()
  # Those of other firmwares are known from the vehicle itself (AVAILABLE_MODES).
  def all(_other, _kind), do: []

  @doc """
  What a name may mean: the numbers of the modes that the firmwares have under it, by autopilot and kind of vehicle. Empty for a
  name that no firmware knows.
  """
  @spec meanings(String.t()) :: [{autopilot(), kind :: String.t(), non_neg_integer()}]
  def meanings(name) do
    for {autopilot, kind} <- firmwares(),
        {:ok, number} <- [number(autopilot, kind, name)],
        do: {autopilot, kind, number}
  end

  @doc "The names of all modes of all firmwares."
  @spec known() :: [String.t()]
  def known,
    do:
      firmwares()
      |> Enum.flat_map(fn {autopilot, kind} -> all(autopilot, kind) end)
      |> Enum.uniq()
      |> Enum.sort()

  # PX4 has the same modes for all kinds.
  defp firmwares, do: [{:px4, "any"} | for(kind <- Ardupilot.Modes.kinds(), do: {:ardupilot, kind})]

  @doc "The mode to be set first, if the firmware refuses to be armed in the present one; nil if it does not, or tells by itself (PX4)."
  @spec arm_first(autopilot(), String.t(), mode :: String.t() | nil) :: String.t() | nil
  def arm_first(:ardupilot, kind, mode), do: Ardupilot.Modes.arm_first(kind, mode)
  def arm_first(_other, _kind, _mode), do: nil

  @doc """
  The number of a vehicle's mode and the name that its state shows: a mode of its firmware, or one that the vehicle
  itself has reported (X4).
  """
  @spec find(Vehicle.t(), String.t()) :: {:ok, non_neg_integer(), String.t()} | :error
  def find(vehicle, name) do
    with :error <- number(vehicle.autopilot, vehicle.kind, name),
         :error <- number_of(vehicle, String.upcase(name)) do
      :error
    else
      {:ok, number} ->
        {:ok, number, name_of(vehicle.autopilot, vehicle.kind, vehicle.mode_names, number)}
    end
  end

  @doc """
  The modes for MAVLink's standard modes (X4): those that the vehicle has reported, and its firmware's for the others, by the names that
  the vehicle's state shows.
  """
  @spec standard(%{
          :autopilot => autopilot(),
          :kind => String.t(),
          :standard_modes => %{String.t() => non_neg_integer()},
          :mode_names => %{non_neg_integer() => String.t()},
          optional(atom()) => term()
        }) :: %{String.t() => String.t()}
  def standard(%{autopilot: autopilot, kind: kind, mode_names: names} = vehicle) do
    known =
      case autopilot do
        :ardupilot -> Ardupilot.Modes.standard(kind)
        :px4 -> Px4.Modes.standard()
        _other -> %{}
      end

    told =
      Map.new(vehicle.standard_modes, fn {name, mode} -> {name, name_of(autopilot, kind, names, mode)} end)

    Map.merge(known, told)
  end

  defp name_of(autopilot, kind, names, mode) do
    name = name(autopilot, kind, @custom, mode)
    if unnamed?(name), do: Map.get(names, mode, name), else: name
  end

  defp number_of(vehicle, name) do
    Enum.find_value(vehicle.mode_names, :error, fn {number, told} ->
      if String.upcase(told) == name, do: {:ok, number}
    end)
  end

  defp by_name(:ardupilot, kind, name) do
    Enum.find_value(Ardupilot.Modes.names(kind), :error, fn {number, known} ->
      if known == name, do: {:ok, number}
    end)
  end

  defp by_name(:px4, _kind, name), do: Px4.Modes.number(name)
  defp by_name(_other, _kind, _name), do: :error

  @doc "Whether the vehicle itself may report a better name: for an external mode, and for an unknown one."
  @spec unnamed?(String.t() | nil) :: boolean()
  def unnamed?("EXTERNAL" <> _number), do: true
  def unnamed?("MODE(" <> _number), do: true
  def unnamed?(_name), do: false

  defp unknown(mode), do: "MODE(#{mode})"
end
