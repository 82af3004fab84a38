defmodule Aerie.Vehicle.Firmware.Modes do
  @moduledoc """
  Flight modes by name, both ways: the behaviour of a firmware's modes, and what others ask about those of a vehicle. A
  number without a name is shown as `MODE(27)` and converts back to the same number.
  """

  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.Firmware.Modes.Flags
  alias Aerie.Vehicle.Protocol.Vehicle

  # The flag in MAV_MODE_FLAG that says that the number of the mode counts.
  @custom 0x01

  @doc "The kinds of vehicles with modes of their own; `any` if all have the same."
  @callback kinds() :: [String.t()]

  @doc "The name of the mode that a heartbeat shows."
  @callback name(kind :: String.t(), base_mode :: integer(), custom_mode :: integer()) :: String.t()

  @doc "The number of a mode's name in capitals."
  @callback number(kind :: String.t(), name :: String.t()) :: {:ok, non_neg_integer()} | :error

  @doc "The modes for which it may take a request (SET_MODE, DO_SET_MODE), its own name for it first."
  @callback asked(kind :: String.t(), base_mode :: integer(), custom_mode :: integer()) :: [String.t(), ...]

  @doc "Why a number cannot be one of a mode; nil if it can."
  @callback wrong(number :: integer()) :: String.t() | nil

  @doc "The names of all modes that can be requested, in the order of their numbers."
  @callback all(kind :: String.t()) :: [String.t()]

  @doc "Its modes for MAVLink's standard modes."
  @callback standard(kind :: String.t()) :: %{String.t() => String.t()}

  @doc "The mode to be set first, if it refuses to be armed in this one; nil if it does not, or tells by itself."
  @callback arm_first(kind :: String.t(), mode :: String.t() | nil) :: String.t() | nil

  @doc "The name of the mode that a heartbeat shows."
  @spec name(Firmware.name(), String.t(), base_mode :: integer(), custom_mode :: integer()) :: String.t()
  def name(firmware, kind, base_mode, mode), do: of(firmware).name(kind, base_mode, mode)

  @doc """
  The number of a mode's name, whose case does not matter; `MODE(27)` is 27. `:error` if this firmware has no such mode.
  """
  @spec number(Firmware.name(), String.t(), String.t()) :: {:ok, non_neg_integer()} | :error
  def number(firmware, kind, name) do
    modes = of(firmware)
    name = String.upcase(name)

    with :error <- modes.number(kind, name),
         [_, digits] <- Regex.run(~r/\AMODE\((\d{1,10})\)\z/, name),
         number = String.to_integer(digits),
         nil <- modes.wrong(number) do
      {:ok, number}
    else
      {:ok, number} -> {:ok, number}
      _no_mode -> :error
    end
  end

  @doc """
  The modes for which a firmware may take a request (SET_MODE, DO_SET_MODE), its own name for it first, or why the number
  cannot be one.
  """
  @spec asked(Firmware.name(), String.t(), base_mode :: integer(), custom_mode :: integer()) ::
          [String.t(), ...] | {:error, String.t()}
  def asked(firmware, kind, base, custom) do
    modes = of(firmware)
    if reason = modes.wrong(custom), do: {:error, reason}, else: Enum.uniq(modes.asked(kind, base, custom))
  end

  @doc "Whether the numbers of a firmware's modes are known here."
  @spec known?(Firmware.name()) :: boolean()
  def known?(firmware), do: of(firmware).kinds() != []

  @doc "The names of all modes that can be requested, in the order of their numbers."
  @spec all(Firmware.name(), String.t()) :: [String.t()]
  def all(firmware, kind), do: of(firmware).all(kind)

  @doc """
  What a name may mean: the numbers of the modes that the firmwares have under it, by firmware and kind of vehicle. Empty
  for a name that no firmware knows.
  """
  @spec meanings(String.t()) :: [{Firmware.name(), kind :: String.t(), non_neg_integer()}]
  def meanings(name) do
    for {firmware, kind} <- tables(),
        {:ok, number} <- [number(firmware, kind, name)],
        do: {firmware, kind, number}
  end

  @doc "The names of all modes of all firmwares."
  @spec names() :: [String.t()]
  def names do
    tables() |> Enum.flat_map(fn {firmware, kind} -> all(firmware, kind) end) |> Enum.uniq() |> Enum.sort()
  end

  defp tables, do: for(firmware <- Firmware.names(), kind <- of(firmware).kinds(), do: {firmware, kind})

  @doc "The mode to be set first, if the firmware refuses to be armed in the present one; nil if it does not, or tells by itself."
  @spec arm_first(Firmware.name(), String.t(), mode :: String.t() | nil) :: String.t() | nil
  def arm_first(firmware, kind, mode), do: of(firmware).arm_first(kind, mode)

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
          :autopilot => Firmware.name(),
          :kind => String.t(),
          :standard_modes => %{String.t() => non_neg_integer()},
          :mode_names => %{non_neg_integer() => String.t()},
          optional(atom()) => term()
        }) :: %{String.t() => String.t()}
  def standard(%{autopilot: firmware, kind: kind, mode_names: names} = vehicle) do
    told =
      Map.new(vehicle.standard_modes, fn {name, mode} -> {name, name_of(firmware, kind, names, mode)} end)

    Map.merge(of(firmware).standard(kind), told)
  end

  defp name_of(firmware, kind, names, mode) do
    name = name(firmware, kind, @custom, mode)
    if unnamed?(name), do: Map.get(names, mode, name), else: name
  end

  defp number_of(vehicle, name) do
    Enum.find_value(vehicle.mode_names, :error, fn {number, told} ->
      if String.upcase(told) == name, do: {:ok, number}
    end)
  end

  @doc "Whether the vehicle itself may report a better name: for an external mode, and for an unknown one."
  @spec unnamed?(String.t() | nil) :: boolean()
  def unnamed?("EXTERNAL" <> _number), do: true
  def unnamed?("MODE(" <> _number), do: true
  def unnamed?(_name), do: false

  @doc "The name of a mode that has none."
  @spec numbered(integer()) :: String.t()
  def numbered(mode), do: "MODE(#{mode})"

  defp of(firmware), do: Firmware.traits(firmware).modes || Flags
end
