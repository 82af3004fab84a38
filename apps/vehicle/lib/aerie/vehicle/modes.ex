defmodule Aerie.Vehicle.Modes do
  @moduledoc """
  Flight modes by name, both ways, for ArduPilot and PX4.

  ArduPilot numbers its modes per firmware (`Aerie.Vehicle.Modes.Ardupilot`), PX4 packs a main and a sub mode into the
  number (`Aerie.Vehicle.Modes.Px4`), others have only the flags of the heartbeat. A number without a name is shown as
  `MODE(27)` and comes back to the same number.
  """

  import Bitwise

  alias Aerie.Vehicle.{Kind, Modes}

  # MAV_MODE_FLAG
  @custom 0x01
  @auto 0x04
  @guided 0x08
  @stabilize 0x10
  @manual 0x40

  @doc "The name of the mode that a heartbeat shows."
  @spec name(Kind.autopilot(), String.t(), base_mode :: integer(), custom_mode :: integer()) :: String.t()
  def name(:ardupilot, kind, _base_mode, mode),
    do: Map.get(Modes.Ardupilot.names(kind), mode) || unknown(mode)

  def name(:px4, _kind, base_mode, mode) when band(base_mode, @custom) != 0 or mode != 0 do
    Modes.Px4.name(mode) || unknown(mode)
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
  The number of a mode's name, without regard to case; `MODE(27)` is 27. `:error` when this firmware has no such mode.
  """
  @spec number(Kind.autopilot(), String.t(), String.t()) :: {:ok, non_neg_integer()} | :error
  def number(autopilot, kind, name) do
    name = String.upcase(name)

    with :error <- by_name(autopilot, kind, name),
         [_, digits] <- Regex.run(~r/\AMODE\((\d{1,10})\)\z/, name) do
      {:ok, String.to_integer(digits)}
    else
      {:ok, number} -> {:ok, number}
      nil -> :error
    end
  end

  @doc "All modes that can be asked for, as names in the order of their numbers."
  @spec all(Kind.autopilot(), String.t()) :: [String.t()]
  def all(:ardupilot, kind), do: kind |> Modes.Ardupilot.names() |> Enum.sort() |> Enum.map(&elem(&1, 1))
  def all(:px4, _kind), do: Modes.Px4.all()
  def all(:generic, _kind), do: []

  defp by_name(:ardupilot, kind, name) do
    Enum.find_value(Modes.Ardupilot.names(kind), :error, fn {number, known} ->
      if known == name, do: {:ok, number}
    end)
  end

  defp by_name(:px4, _kind, name), do: Modes.Px4.number(name)
  defp by_name(:generic, _kind, _name), do: :error

  @doc "Whether a name is one that the vehicle itself may have a better one for: an external mode, or one that is not known."
  @spec unnamed?(String.t() | nil) :: boolean()
  def unnamed?("EXTERNAL" <> _number), do: true
  def unnamed?("MODE(" <> _number), do: true
  def unnamed?(_name), do: false

  defp unknown(mode), do: "MODE(#{mode})"
end
