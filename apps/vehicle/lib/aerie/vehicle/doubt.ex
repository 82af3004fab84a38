defmodule Aerie.Vehicle.Doubt do
  @moduledoc """
  Whether what comes may be of two vehicles with one id, before that is certain. A pure value.

  `Aerie.Vehicle.Twin` takes some seconds to be sure. Until then the one that flies must not be told as landed and disarmed
  because another one was switched on: while boot times, places or kinds take turns, while a way to the vehicle is new, or
  while two ways bring heartbeats that differ, a change of the state has to stay for a second and a half before it counts.
  Two links to one vehicle agree again with the second one's next heartbeat, and then it counts at once.

  A change after a silence waits as well, until the vehicle's clock has shown whether it was restarted: that it is disarmed
  since follows from the reboot, and is told after it.
  """

  alias Aerie.Vehicle.{Rivals, Twin}

  # A sign of two is worth this long.
  @sign_us 3_000_000
  @stays_us 1_500_000
  @max_ways 32

  defstruct beats: %{}, held: nil

  @type t :: %__MODULE__{
          beats: %{Rivals.way() => {term(), integer()}},
          held: {term(), since :: integer()} | nil
        }

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "A heartbeat came by a way; `what` it says of the vehicle."
  @spec beat(t(), Rivals.way(), term(), integer()) :: t()
  def beat(%{beats: beats} = doubt, way, what, at) do
    beats = if map_size(beats) < @max_ways, do: beats, else: %{}
    %{doubt | beats: Map.put(beats, way, {what, at})}
  end

  @doc "Whether there may be two as of `at`. Whose frames are kept apart already is no doubt any more."
  @spec two?(t(), Twin.t(), Rivals.t(), integer()) :: boolean()
  def two?(doubt, twin, rivals, at) do
    differ?(doubt.beats, at) or
      (Rivals.others(rivals, at) == [] and
         (recent?(Twin.flipped_at(twin), at) or Rivals.new?(rivals, at, @sign_us)))
  end

  defp differ?(beats, _at) when map_size(beats) < 2, do: false

  defp differ?(beats, at) do
    fresh = for {_way, {what, said}} <- beats, at - said <= @sign_us, do: what
    match?([_, _ | _], Enum.uniq(fresh))
  end

  defp recent?(nil, _at), do: false
  defp recent?(flipped, at), do: at - flipped <= @sign_us

  @doc """
  The state is another one than was shown last. `{:wait, doubt}`: it has to stay first; `{:go, since, doubt}`: it counts,
  and is as it is since then.
  """
  @spec change(t(), state :: term(), why :: :two | :restart | nil, integer()) ::
          {:wait, t()} | {:go, integer(), t()}
  def change(%{held: {state, since}} = doubt, state, why, at) do
    if why == :restart or (why == :two and at - since < @stays_us),
      do: {:wait, doubt},
      else: {:go, since, %{doubt | held: nil}}
  end

  def change(doubt, _state, nil, at), do: {:go, at, %{doubt | held: nil}}
  def change(doubt, state, _why, at), do: {:wait, %{doubt | held: {state, at}}}

  @doc "It was restarted, as is known `at`: what is held follows from that."
  @spec rebooted(t(), integer()) :: t()
  def rebooted(%{held: {state, _since}} = doubt, at), do: %{doubt | held: {state, at}}
  def rebooted(doubt, _at), do: doubt

  @doc "It is as it was."
  @spec same(t()) :: t()
  def same(%{held: nil} = doubt), do: doubt
  def same(doubt), do: %{doubt | held: nil}
end
