defmodule Aerie.Fleet.Tracks.Core do
  @moduledoc """
  Decides which vehicles get a sample at a tick, and when a group of blocks begins. Pure: `handle(core, event)` gives
  the core and actions.

  A vehicle in the air has one at each tick, any other one each 30 s, and at once when its mode, arming or contact
  changes. Each minute begins with all of them. A block that could not be written also ends its group, because what
  follows would build on it.
  """

  alias Aerie.Fleet.Tracks.{Block, Sample}

  # Less than 30 s, because ticks come a little early or late.
  @ground_ms 29_500
  @group_ms 60_000

  @enforce_keys [:group]
  defstruct [:group, last: %{}]

  @opaque t :: %__MODULE__{}
  @typedoc "At a tick, with all vehicles (unix milliseconds); the block of the last tick was not written."
  @type event :: {:tick, at :: non_neg_integer(), [{String.t(), Sample.t()}]} | :not_written
  @typedoc "A block to write, with the samples in it, and whether it begins a group; samples that were left out."
  @type action ::
          {:write, at :: non_neg_integer(), begins? :: boolean(), iodata(), samples :: pos_integer()}
          | {:left_out, pos_integer()}

  @spec new() :: t()
  def new, do: %__MODULE__{group: Block.new()}

  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(core, :not_written), do: {%{core | group: Block.new()}, []}

  def handle(core, {:tick, at, samples}) do
    {fit, rest} = samples |> Enum.split(Block.max_vehicles())
    {named, unnamed} = Enum.split_with(fit, fn {name, _sample} -> Block.name?(name) end)
    left_out = length(rest) + length(unnamed)
    core = at |> group(core) |> forget(named)
    begins? = Block.start(core.group) == nil
    due = if begins?, do: named, else: Enum.filter(named, &due?(&1, at, core.last))
    {core, if(left_out > 0, do: [{:left_out, left_out}], else: [])} |> write(due, at, begins?)
  end

  # At a full minute, and when the clock was set back.
  defp group(at, %{group: group} = core) do
    start = Block.start(group)

    if start != nil and (at < start or div(at, @group_ms) != div(start, @group_ms)),
      do: %{core | group: Block.new()},
      else: core
  end

  # Not each time: the vehicles of a fleet hardly ever go.
  defp forget(%{last: last} = core, samples) when map_size(last) > 2 * length(samples),
    do: %{core | last: Map.take(last, Enum.map(samples, &elem(&1, 0)))}

  defp forget(core, _samples), do: core

  defp due?({name, sample}, at, last) do
    case last do
      %{^name => {then, flags, mode}} ->
        Sample.flying?(sample) or sample.flags != flags or sample.mode != mode or at - then >= @ground_ms

      _new ->
        true
    end
  end

  defp write({core, actions}, [], _at, _begins?), do: {core, actions}

  defp write({core, actions}, due, at, begins?) do
    {block, group} = Block.encode(core.group, at, due)
    last = for {name, sample} <- due, into: core.last, do: {name, {at, sample.flags, sample.mode}}
    {%{core | group: group, last: last}, [{:write, at, begins?, block, length(due)} | actions]}
  end
end
