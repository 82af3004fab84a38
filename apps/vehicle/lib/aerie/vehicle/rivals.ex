defmodule Aerie.Vehicle.Rivals do
  @moduledoc """
  By which ways a vehicle is heard, and by which of them another one is that uses its system id. A pure value.

  When `Aerie.Vehicle.Twin` finds two, and each is heard by a way of its own, the one that was there first keeps the id:
  frames by the other's ways are no state of this vehicle, are not forwarded, and nothing goes there that is addressed to
  the id (`other?/3`, `others/2`). So a vehicle that is switched on beside one that flies can neither be taken for it nor
  obey its orders. That holds for a minute after the last sign of two, and as long as the first one is heard at all: when
  it falls silent, the id is the other's.

  A way is a link's id, or that with one of its peers where several bring the system.
  """

  alias Aerie.Router.Apart

  @hold_us 60_000_000
  @silent_us 5_000_000
  @max_ways 32

  defstruct ways: %{}, others: [], kept: [], until: nil

  @type way :: term()
  @type t :: %__MODULE__{
          ways: %{way() => {first :: integer(), last :: integer()}},
          others: [way()],
          kept: [way()],
          until: integer() | nil
        }

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "The system was heard by a way. Who was silent for five seconds begins anew."
  @spec heard(t(), way(), integer()) :: t()
  def heard(%{ways: ways} = rivals, way, at) do
    case ways do
      %{^way => {first, last}} when at - last <= @silent_us ->
        %{rivals | ways: %{ways | way => {first, max(at, last)}}}

      %{^way => _silent} ->
        # Who gave the id up by silence does not get it back by coming again.
        %{if(holds?(rivals, at), do: rivals, else: over(rivals)) | ways: %{ways | way => {at, at}}}

      _new when map_size(ways) < @max_ways ->
        %{rivals | ways: Map.put(ways, way, {at, at})}

      _full ->
        %{
          rivals
          | ways:
              ways |> Map.filter(fn {_, {_, last}} -> at - last <= @silent_us end) |> Map.put(way, {at, at})
        }
    end
  end

  @doc "Whether a way was heard first within the last `us`, while another one is heard for longer."
  @spec new?(t(), integer(), pos_integer()) :: boolean()
  def new?(%{ways: ways}, _now, _us) when map_size(ways) < 2, do: false

  def new?(%{ways: ways}, now, us) do
    firsts = for {_way, {first, last}} <- ways, now - last <= us, do: first
    firsts != [] and now - Enum.max(firsts) <= us and Enum.max(firsts) != Enum.min(firsts)
  end

  defp over(rivals), do: %{rivals | kept: [], others: [], until: nil}

  @doc """
  There are two, and these ways brought the one and these the other (some perhaps both): the same two, that of whom keeps the
  id first.
  """
  @spec found(t(), [way()], [way()], integer()) :: {t(), kept :: [way()], other :: [way()]}
  def found(rivals, ones, others, at) do
    {kept, other} = if second?(rivals, ones, others, at), do: {others, ones}, else: {ones, others}
    apart = other -- kept

    # Both by one way: told, but nobody can take them apart.
    if apart == [] or kept -- other == [],
      do: {rivals, kept, other},
      else: {%{rivals | kept: kept -- other, others: apart, until: at + @hold_us}, kept, other}
  end

  # Whether the second of the two keeps the id: it does so already, or was there earlier.
  defp second?(rivals, ones, others, at) do
    cond do
      not holds?(rivals, at) -> first(rivals, others) < first(rivals, ones)
      Enum.any?(rivals.kept, &(&1 in ones)) -> false
      Enum.any?(rivals.others, &(&1 in ones)) -> true
      true -> first(rivals, others) < first(rivals, ones)
    end
  end

  defp first(rivals, ways) do
    # An atom is more than any number.
    ways |> Enum.map(&with({first, _last} <- rivals.ways[&1], do: first)) |> Enum.min(fn -> nil end)
  end

  @doc "Whether a way is another vehicle's just now."
  @spec other?(t(), way(), integer()) :: boolean()
  def other?(%{others: []}, _way, _now), do: false
  def other?(rivals, way, now), do: way in rivals.others and holds?(rivals, now)

  @doc "The ways that are another vehicle's just now."
  @spec others(t(), integer()) :: [way()]
  def others(%{others: []}, _now), do: []
  def others(rivals, now), do: if(holds?(rivals, now), do: Enum.sort(rivals.others), else: [])

  defp holds?(%{until: nil}, _now), do: false

  defp holds?(rivals, now) do
    now < rivals.until and
      Enum.any?(rivals.kept, fn way ->
        match?({_first, last} when now - last <= @silent_us, rivals.ways[way])
      end)
  end

  @doc "What was another time is `now`: who was heard before cannot be compared."
  @spec rebased(t()) :: t()
  def rebased(_rivals), do: new()

  @doc "The clock was set by `step`: who was heard was heard as long ago as before."
  @spec shifted(t(), integer()) :: t()
  def shifted(rivals, step) do
    ways = Map.new(rivals.ways, fn {way, {first, last}} -> {way, {first + step, last + step}} end)
    %{rivals | ways: ways, until: rivals.until && rivals.until + step}
  end

  @doc "The link of a way."
  @spec link(way()) :: term()
  def link({link, _peer}), do: link
  def link(link), do: link

  @doc "The ways of the one and of the other in words: their links, where these are not the same; else the links' peers."
  @spec words([way()], [way()]) :: [[String.t()]]
  def words(kept, other) do
    sides = [links, _] = for side <- [kept, other], do: side |> Enum.map(&link/1) |> Enum.uniq()

    sides =
      if Enum.any?(List.last(sides), &(&1 in links)),
        do: for(side <- [kept, other], do: Enum.reject(side, &(not is_tuple(&1) and peers?(side, &1)))),
        else: sides

    for side <- sides, do: side |> Enum.map(&Apart.text/1) |> Enum.sort()
  end

  # Before the other one came the link alone was name enough.
  defp peers?(side, link), do: Enum.any?(side, &match?({^link, _peer}, &1))
end
