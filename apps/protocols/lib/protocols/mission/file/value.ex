defmodule Protocols.Mission.File.Value do
  @moduledoc "Checks the values of plan files. Errors say where a value is and what was expected."

  alias Aerie.Base.Json
  alias Protocols.Mission.Item
  alias MavCodec.Enums.{MavCmd, MavFrame}

  @mission_frame MavFrame.value(:MAV_FRAME_MISSION)
  @int32 2_147_483_646

  @type error :: {:error, String.t()}

  @doc """
  An item made of the numbers that both kinds of files have: frame, command, parameters 1 to 7, each a number or nil, and
  autocontinue. `at` is where it stands.
  """
  @spec item(term(), term(), [term()], boolean(), String.t()) :: {:ok, Item.t()} | error()
  def item(frame, command, [p1, p2, p3, p4, p5, p6, p7], autocontinue?, at) do
    with {:ok, frame} <- integer(frame, 0..255, at <> " frame"),
         {:ok, command} <- integer(command, 0..65_535, at <> " command"),
         {:ok, params} <- all([p1, p2, p3, p4], &float(&1, "#{at} param#{&2}")),
         {:ok, x} <- place(p5, 5, command, frame, at),
         {:ok, y} <- place(p6, 6, command, frame, at),
         {:ok, z} <- float(p7, at <> " param7") do
      {:ok,
       %Item{
         frame: frame,
         command: command,
         params: List.to_tuple(params),
         x: x,
         y: y,
         z: z,
         autocontinue: if(autocontinue?, do: 1, else: 0)
       }}
    end
  end

  @doc "The numbers of an item as files store them."
  @spec numbers(Item.t()) :: [number() | nil]
  def numbers(item) do
    Tuple.to_list(item.params) ++ [format(item.x, item), format(item.y, item), item.z]
  end

  @doc "A position from degrees."
  @spec position(term(), term(), String.t()) :: {:ok, {integer(), integer()}} | error()
  def position(lat, lon, at) do
    with {:ok, lat} <- degrees(lat, 90, at <> " latitude"),
         {:ok, lon} <- degrees(lon, 180, at <> " longitude"),
         do: {:ok, {lat, lon}}
  end

  @doc "The degrees of a position."
  @spec degrees({integer(), integer()}) :: [float()]
  def degrees({lat, lon}), do: [lat / 1.0e7, lon / 1.0e7]

  @doc "A number that fits into a 32-bit float; nil stays nil."
  @spec float(term(), String.t()) :: {:ok, float() | nil} | error()
  def float(nil, _at), do: {:ok, nil}

  def float(value, at) do
    if is_number(value) and Item.fits?(value), do: {:ok, value / 1}, else: error(at, "a number", value)
  end

  @doc "A number that is required."
  @spec number(term(), String.t()) :: {:ok, float()} | error()
  def number(nil, at), do: error(at, "a number", nil)
  def number(value, at), do: float(value, at)

  @spec integer(term(), Range.t(), String.t()) :: {:ok, integer()} | error()
  def integer(value, range, at) do
    if is_integer(value) and value in range,
      do: {:ok, value},
      else: error(at, "a whole number from #{range.first} to #{range.last}", value)
  end

  @doc "Maps a list by a function of the value and its number from 1, up to the first error."
  @spec all([term()], (term(), pos_integer() -> {:ok, term()} | error())) :: {:ok, [term()]} | error()
  def all(values, fun) do
    values
    |> Enum.with_index(1)
    |> Enum.reduce_while([], fn {value, n}, done ->
      case fun.(value, n) do
        {:ok, value} -> {:cont, [value | done]}
        error -> {:halt, error}
      end
    end)
    |> then(&if is_list(&1), do: {:ok, Enum.reverse(&1)}, else: &1)
  end

  @doc "Maps a list of at most `most` values, each with its place."
  @spec list(term(), pos_integer(), String.t(), (term(), String.t() -> {:ok, term()} | error())) ::
          {:ok, [term()]} | error()
  def list(values, most, at, fun) when is_list(values) do
    if length(values) <= most,
      do: all(values, &fun.(&1, "#{at}[#{&2 - 1}]")),
      else: {:error, "#{at}: #{length(values)} entries; at most #{most} are read"}
  end

  def list(other, _most, at, _fun), do: error(at, "a list", other)

  @spec error(String.t(), String.t(), term()) :: error()
  def error(at, expected, got) do
    {:error, "#{at}: expected #{expected}, got #{Json.shown(got, 40)}"}
  end

  @most %{5 => 90, 6 => 180}

  defp place(value, index, command, frame, at) do
    at = "#{at} param#{index}"

    cond do
      not Item.place?(command, frame) -> whole(value, index, {command, frame}, at)
      value == nil -> {:ok, nil}
      not Item.local?(frame) -> degrees(value, @most[index], at)
      is_number(value) and abs(value) <= 200_000 -> {:ok, round(value * 1.0e4)}
      true -> error(at, "metres up to 200000", value)
    end
  end

  # Parameters 5 and 6 are integers on the wire, so without a place they must be whole numbers.
  defp whole(nil, _index, _of, _at), do: {:ok, 0}

  defp whole(value, index, {command, frame}, at) do
    cond do
      is_number(value) and abs(value) <= @int32 and trunc(value) == value ->
        {:ok, trunc(value)}

      frame == @mission_frame ->
        error(at, "a whole number, because the frame is MISSION", value)

      degrees?(command, index) ->
        degrees(value, @most[index], at)

      true ->
        error(at, "a whole number, because the command has no place", value)
    end
  end

  # Some programs write a place into parameters that the command does not have: a fraction can only be degrees.
  defp degrees?(command, index) do
    case Enum.find(MavCmd.params(command), &(&1.index == index)) do
      %{label: label} -> label in [nil, "Latitude", "Longitude"]
      nil -> true
    end
  end

  defp degrees(value, most, at) do
    if is_number(value) and abs(value) <= most,
      do: {:ok, round(value * 1.0e7)},
      else: error(at, "degrees from -#{most} to #{most}", value)
  end

  defp format(nil, _item), do: nil

  defp format(value, item) do
    cond do
      not Item.place?(item.command, item.frame) -> value
      Item.local?(item.frame) -> value / 1.0e4
      true -> value / 1.0e7
    end
  end
end
