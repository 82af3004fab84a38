defmodule Msp.Receiver.Switches do
  @moduledoc """
  Which positions of the switches arm a vehicle and select a mode, by the ranges that are configured (MODE_RANGES).

  Each channel is chosen by itself: of its positions the one that switches on what is wanted and as little else as possible.
  """

  alias Msp.{Firmware, Modes}

  @arm 0
  # A range is from 900 + 25 n µs on, and ends before the last one; receivers have 1000 to 2000.
  @positions Enum.map(0..40, &(1000 + 25 * &1))
  # In the middle of a step, so that rounding on the way changes nothing.
  @inside 12

  @type range :: %{box: byte, aux: byte, start: byte, end: byte}

  @doc """
  The pulse widths in µs of the auxiliary channels that have ranges, by their numbers from 0. An error if no position selects the mode, or
  none arms.
  """
  @spec choose(Modes.firmware(), [range], mode :: byte, armed? :: boolean) ::
          {:ok, %{byte => pos_integer}} | {:error, String.t()}
  def choose(firmware, ranges, mode, armed?) do
    ranges = Enum.filter(ranges, &(&1.start < &1.end))

    chosen =
      for {aux, own} <- Enum.group_by(ranges, & &1.aux), into: %{} do
        {aux, Enum.min_by(@positions, &{cost(firmware, on(own, &1), mode, armed?), &1}) + @inside}
      end

    on = MapSet.new(for range <- ranges, active?(range, chosen[range.aux]), do: range.box)

    cond do
      armed? != @arm in on ->
        {:error,
         if(armed?, do: "no switch is configured that arms it", else: "each position of a switch arms it")}

      Modes.mode(firmware, on) != mode ->
        {:error,
         "its switches cannot select #{Modes.name(firmware, mode)}: no range of a channel does that alone"}

      true ->
        {:ok, chosen}
    end
  end

  @doc "The auxiliary channels that arm it."
  @spec arming([range]) :: [byte]
  def arming(ranges),
    do: for(range <- ranges, range.box == @arm, range.start < range.end, uniq: true, do: range.aux)

  # The pulse width at a whole step.
  defp on(ranges, us), do: for(range <- ranges, active?(range, us), do: range.box)

  defp active?(%{start: first, end: last}, us), do: us >= 900 + 25 * first and us < 900 + 25 * last

  defp cost(firmware, boxes, mode, armed?) do
    prearm = Firmware.of(firmware).prearm
    modes = for {id, _name} <- Modes.all(firmware), id != @arm, do: id

    Enum.sum(
      for box <- Enum.uniq(boxes) do
        cond do
          box == @arm -> if armed?, do: -10_000, else: 10_000
          box == mode -> -1_000
          box == prearm -> if armed?, do: -100, else: 1
          box in modes -> 100
          true -> 10
        end
      end
    )
  end
end
