defmodule Aerie.Console.Pages.Fleet.Act.Sheet do
  @moduledoc """
  What all sheets have: vehicles in an order, those of them that are left out, numbers with limits, and a press that is
  for what was shown. Pure. A sheet is a struct with `:order`, `:out` and `:error`.
  """

  alias Aerie.Vehicle.Snapshot

  @type t :: struct()
  @type limits :: %{atom() => {number(), number()}}

  # What a sheet shows, and does, of what is known of its vehicles (`facts`).
  @doc "What a press carries: all that it does, as the operator sees it."
  @callback shown(t(), facts :: map()) :: map()
  @doc "Why nothing can begin; nil if it can."
  @callback refusal(t(), facts :: map()) :: String.t() | nil
  @doc "After an event of the page: its name without `sheet_`, and its value."
  @callback event(t(), event :: String.t(), value :: map()) :: t()

  @most 100

  @doc "As many vehicles as a sheet takes."
  @spec most() :: pos_integer()
  def most, do: @most

  @doc "The numbers of a form within their limits, and in words what is wrong with the others; nil for nothing."
  @spec numbers(limits(), fields :: map()) :: {%{atom() => number()}, String.t() | nil}
  def numbers(limits, fields) do
    {numbers, wrong} =
      for {key, {min, max}} <- limits, text = fields[Atom.to_string(key)], reduce: {%{}, []} do
        {numbers, wrong} ->
          case number(text, min, max) do
            {:ok, number} -> {Map.put(numbers, key, number), wrong}
            :error -> {numbers, ["#{key}: expected a number from #{min} to #{max}" | wrong]}
          end
      end

    {numbers, if(wrong != [], do: Enum.join(wrong, "; "))}
  end

  defp number(text, min, max) when is_binary(text) do
    case Float.parse(text) do
      {number, ""} when number >= min and number <= max -> {:ok, whole(Float.round(number, 1))}
      _other -> :error
    end
  end

  defp number(_other, _min, _max), do: :error

  defp whole(number) when trunc(number) == number, do: trunc(number)
  defp whole(number), do: number

  @doc "Moves a vehicle to the place of another, or by one place up or down."
  @spec move(t(), String.t(), to :: String.t()) :: t()
  def move(%{order: order} = sheet, id, to) do
    at = Enum.find_index(order, &(&1 == id))

    place =
      case to do
        "up" -> at && at - 1
        "down" -> at && at + 1
        other -> Enum.find_index(order, &(&1 == other))
      end

    if at == nil or place == nil or place < 0,
      do: sheet,
      else: %{sheet | order: order |> List.delete_at(at) |> List.insert_at(place, id)}
  end

  @doc "Leaves a vehicle out, or takes it along again."
  @spec leave(t(), String.t()) :: t()
  def leave(%{out: out} = sheet, id) do
    cond do
      id not in sheet.order -> sheet
      MapSet.member?(out, id) -> %{sheet | out: MapSet.delete(out, id)}
      true -> %{sheet | out: MapSet.put(out, id)}
    end
  end

  @doc "The vehicles in their order, each with how many go before it; nil for one that is left out."
  @spec places(t()) :: [{String.t(), non_neg_integer() | nil}]
  def places(sheet) do
    {places, _n} =
      Enum.map_reduce(sheet.order, 0, fn id, n ->
        if MapSet.member?(sheet.out, id), do: {{id, nil}, n}, else: {{id, n}, n + 1}
      end)

    places
  end

  @doc "Whether a press was made for what is shown now."
  @spec meant?(event :: map(), shown :: map()) :: boolean()
  def meant?(event, shown), do: Map.take(event, Map.keys(shown)) == shown

  @doc "A place of a snapshot's group, `:position` or `:home`; nil if it is not known."
  @spec place(Snapshot.t(), atom()) :: {number(), number()} | nil
  def place(snapshot, group \\ :position) do
    with %{lat: lat, lon: lon} when is_number(lat) and is_number(lon) <- Snapshot.data(snapshot, group),
         do: {lat, lon},
         else: (_unknown -> nil)
  end
end
