defmodule Aerie.Vehicle.State.Sampling.Mean do
  @moduledoc """
  The mean of maps: of each number over the samples that have it, of angles on the circle; anything but a number has its last
  value.

  A key that is nil in every sample is nil. Angles are the keys `heading`, `yaw`, `roll`, `pitch` and `lon`: the mean of
  359° and 1° is 0°, and a vehicle at the date line is not at Greenwich. The result is in the range of the input
  (0..360 for `heading`, -180..180 for the others).
  """

  @angles [:heading, :yaw, :roll, :pitch, :lon]
  @radian 0.017453292519943295

  defstruct sums: %{}, last: %{}, count: 0, at: nil

  @type t :: %__MODULE__{}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "The number of samples."
  @spec count(t()) :: non_neg_integer()
  def count(mean), do: mean.count

  @doc "When the last sample came; nil if there is none."
  @spec at(t()) :: integer() | nil
  def at(mean), do: mean.at

  @spec add(t(), integer(), map()) :: t()
  def add(mean, at, data) do
    # Hot path: called for each message.
    %{mean | sums: sums(:maps.to_list(data), mean.sums), last: data, count: mean.count + 1, at: at}
  end

  defp sums([], sums), do: sums

  # Angles are added relative to the first one, so equal angles give exactly that angle.
  defp sums([{key, value} | rest], sums) when is_number(value) and key in @angles do
    case sums do
      %{^key => {first, x, y}} ->
        turn = (value - first) * @radian
        sums(rest, %{sums | key => {first, x + :math.cos(turn), y + :math.sin(turn)}})

      _first ->
        sums(rest, Map.put(sums, key, {value, 1.0, 0.0}))
    end
  end

  # A running mean never leaves the range of its values, as a sum divided at the end might by rounding.
  defp sums([{key, value} | rest], sums) when is_number(value) do
    case sums do
      %{^key => {mean, n}} -> sums(rest, %{sums | key => {mean + (value - mean) / (n + 1), n + 1}})
      _first -> sums(rest, Map.put(sums, key, {value, 1}))
    end
  end

  defp sums([_no_number | rest], sums), do: sums(rest, sums)

  @spec result(t()) :: map()
  def result(mean), do: Map.merge(mean.last, Map.new(mean.sums, fn {key, sum} -> {key, value(key, sum)} end))

  defp value(_key, {mean, _n}), do: mean

  # Opposite directions have no mean; the first one is used.
  defp value(_key, {first, x, y}) when x * x + y * y < 1.0e-12, do: first
  defp value(key, {first, x, y}), do: wrap(key, first + :math.atan2(y, x) / @radian)

  defp wrap(:heading, degrees) when degrees < 0, do: degrees + 360
  defp wrap(:heading, degrees) when degrees >= 360, do: degrees - 360
  defp wrap(:heading, degrees), do: degrees
  defp wrap(_key, degrees) when degrees > 180, do: degrees - 360
  defp wrap(_key, degrees) when degrees < -180, do: degrees + 360
  defp wrap(_key, degrees), do: degrees
end
