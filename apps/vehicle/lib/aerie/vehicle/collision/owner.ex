defmodule Aerie.Vehicle.Collision.Owner do
  @moduledoc """
  Which of two vehicles with one system id owns it, by the paths that each is heard on. A pure value.

  When `Aerie.Vehicle.Collision.Detector` finds two vehicles and each has a path of its own, the one that was heard first
  keeps the id. Frames by the other one's paths do not change this vehicle's state and are not forwarded, and nothing
  addressed to the id is sent there (`other?/3`, `others/2`). So a vehicle that is switched on beside one that flies can
  neither be mistaken for it nor obey its commands. That lasts for a minute after the last sign of a collision, provided
  that the owner is still heard: when the other vehicle has been heard for five seconds without it, the id goes to the other
  one. Time in which neither is heard does not count, because then it may be this machine that stood still.
  """

  alias MavRouter.Routes.Collisions

  @hold_us 60_000_000
  @silent_us 5_000_000
  # A vehicle sends more often than that: a longer gap may be this machine's.
  @gap_us 2_000_000
  @max_paths 32

  defstruct paths: %{}, others: [], kept: [], until: nil, proved: nil, says: []

  @typedoc "How a vehicle is heard: a link's id, or `{link, peer}` where several peers of a link bring the system."
  @type path :: term()
  @typedoc """
  `paths`: when a path was heard first, since when without a gap, and last; `kept`: the owner's own paths; `others`: those of the
  other vehicle; `until`: how long that holds. `proved`: the path by which the vehicle said what it is (firmware, type,
  component);
  `says`: the links that say so themselves (MSP).
  """
  @type t :: %__MODULE__{
          paths: %{path() => {first :: integer(), since :: integer(), last :: integer()}},
          others: [path()],
          kept: [path()],
          until: integer() | nil,
          proved: path() | nil,
          says: [term()]
        }

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "The system was heard by a path. After five seconds of silence a path counts as new."
  @spec seen(t(), path(), integer()) :: t()
  def seen(%{paths: paths} = owner, path, at) do
    case paths do
      %{^path => {first, since, last}} when at - last <= @silent_us ->
        since = if at - last > @gap_us, do: at, else: since
        %{owner | paths: %{paths | path => {first, since, max(at, last)}}}

      %{^path => _silent} ->
        # A vehicle that lost the id by its silence does not get it back when it returns.
        %{if(holds?(owner, at), do: owner, else: none(owner)) | paths: %{paths | path => {at, at, at}}}

      _new when map_size(paths) < @max_paths ->
        %{owner | paths: Map.put(paths, path, {at, at, at})}

      _full ->
        recent = Map.filter(paths, fn {_path, {_first, _since, last}} -> at - last <= @silent_us end)
        %{owner | paths: Map.put(recent, path, {at, at, at})}
    end
  end

  @doc "Whether a path was first heard within the last `us`, while another one has been heard for longer."
  @spec new_path?(t(), integer(), pos_integer()) :: boolean()
  def new_path?(%{paths: paths}, _now, _us) when map_size(paths) < 2, do: false

  def new_path?(%{paths: paths}, now, us) do
    firsts = for {_path, {first, _since, last}} <- paths, now - last <= us, do: first
    firsts != [] and now - Enum.max(firsts) <= us and Enum.max(firsts) != Enum.min(firsts)
  end

  defp none(owner), do: %{owner | kept: [], others: [], until: nil}

  @doc "A link says itself what its vehicle is: nobody else changes that."
  @spec says(t(), link :: term(), boolean()) :: t()
  def says(owner, link, true), do: %{owner | says: Enum.uniq([link | owner.says])}
  def says(owner, link, false), do: %{owner | says: List.delete(owner.says, link)}

  @doc """
  The vehicle said by a path what it is, as is known already or as it may (`changes?/3`). The path that proved it stays
  the one that does, until it is
  silent.
  """
  @spec proves(t(), path(), integer()) :: t()
  def proves(%{proved: nil} = owner, path, _now), do: %{owner | proved: path}
  def proves(owner, path, now), do: if(changes?(owner, path, now), do: %{owner | proved: path}, else: owner)

  @doc """
  Whether what a frame by this path says of the vehicle's firmware, type or component may differ from what is known. In
  a session that was
  restarted, of which it is not known who proved it, a path has to be heard for a minute.
  """
  @spec changes?(t(), path(), integer()) :: boolean()
  def changes?(owner, path, now) do
    cond do
      same?(owner.proved, path) or link(path) in owner.says -> true
      owner.proved == nil -> match?({first, _since, _last} when now - first > @hold_us, owner.paths[path])
      link(owner.proved) in owner.says -> false
      true -> not match?({_first, _since, last} when now - last <= @hold_us, owner.paths[owner.proved])
    end
  end

  @doc """
  A collision was found: `ones` brought the one vehicle and `others` the other (some paths perhaps both). Returns both lists
  again, the owner's first.
  """
  @spec decide(t(), [path()], [path()], integer()) :: {t(), kept :: [path()], other :: [path()]}
  def decide(owner, ones, others, at) do
    {kept, other} = if second?(owner, ones, others, at), do: {others, ones}, else: {ones, others}
    separate = other -- kept

    # If one of them has no path of its own, the collision is reported, but the vehicles cannot be separated.
    if separate == [] or kept -- other == [],
      do: {owner, kept, other},
      else: {held(owner, kept -- other, separate, at), kept, other}
  end

  # The one with the id says what it is.
  defp held(%{proved: proved} = owner, [path | _] = kept, others, at) do
    proved = if Enum.any?(others, &same?(proved, &1)), do: path, else: proved
    %{owner | kept: kept, others: others, until: at + @hold_us, proved: proved}
  end

  # Whether the second one keeps the id: its link says what it is, it has it already, or was heard earlier.
  defp second?(owner, ones, others, at) do
    said = {said?(owner, ones), said?(owner, others)}

    cond do
      said == {true, false} -> false
      said == {false, true} -> true
      not holds?(owner, at) -> first(owner, others) < first(owner, ones)
      Enum.any?(owner.kept, &(&1 in ones)) -> false
      Enum.any?(owner.others, &(&1 in ones)) -> true
      true -> first(owner, others) < first(owner, ones)
    end
  end

  defp first(owner, paths) do
    # nil, an atom, is greater than any number. Until a second peer came, a path was its link.
    for(
      path <- paths,
      known <- [path, link(path)],
      do: with({first, _since, _last} <- owner.paths[known], do: first)
    )
    |> Enum.min(fn -> nil end)
  end

  defp said?(owner, paths), do: Enum.any?(paths, &(link(&1) in owner.says))

  # A link with one peer.
  defp same?(link, {link, :remote}), do: true
  defp same?(proved, path), do: proved == path

  @doc "Whether a path is another vehicle's at this time."
  @spec other?(t(), path(), integer()) :: boolean()
  def other?(%{others: []}, _path, _now), do: false
  def other?(owner, path, now), do: path in owner.others and holds?(owner, now)

  @doc "The paths that are another vehicle's at this time."
  @spec others(t(), integer()) :: [path()]
  def others(%{others: []}, _now), do: []
  def others(owner, now), do: if(holds?(owner, now), do: Enum.sort(owner.others), else: [])

  defp holds?(%{until: nil}, _now), do: false

  defp holds?(owner, now), do: now < owner.until and not outlived?(owner)

  # Whether the other vehicle has been heard for long enough without the owner.
  defp outlived?(%{paths: paths} = owner) do
    case for path <- owner.kept, {_first, _since, last} <- [paths[path]], do: last do
      [] ->
        true

      lasts ->
        kept = Enum.max(lasts)

        Enum.any?(owner.others, fn path ->
          match?({_first, since, last} when last - max(kept, since) > @silent_us, paths[path])
        end)
    end
  end

  @doc "The clock was set by `step` (us): every path was heard as long ago as before."
  @spec shifted(t(), integer()) :: t()
  def shifted(owner, step) do
    paths =
      Map.new(owner.paths, fn {path, {first, since, last}} ->
        {path, {first + step, since + step, last + step}}
      end)

    %{owner | paths: paths, until: owner.until && owner.until + step}
  end

  @doc "The link of a path."
  @spec link(path()) :: term()
  def link({link, _peer}), do: link
  def link(link), do: link

  @doc "Both lists of paths as text: the links' names, with the peers where the names alone would be the same."
  @spec describe([path()], [path()]) :: [[String.t()]]
  def describe(kept, other) do
    sides = [links, _] = for side <- [kept, other], do: side |> Enum.map(&link/1) |> Enum.uniq()

    sides =
      if Enum.any?(List.last(sides), &(&1 in links)),
        do: for(side <- [kept, other], do: Enum.reject(side, &(not is_tuple(&1) and peers?(side, &1)))),
        else: sides

    for side <- sides, do: side |> Enum.map(&Collisions.text/1) |> Enum.sort()
  end

  # Until the second peer came, the vehicle was known by the link alone.
  defp peers?(side, link), do: Enum.any?(side, &match?({^link, _peer}, &1))
end
