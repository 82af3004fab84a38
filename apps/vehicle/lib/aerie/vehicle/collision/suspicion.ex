defmodule Aerie.Vehicle.Collision.Suspicion do
  @moduledoc """
  Whether frames may be those of two vehicles with one id, before that is certain. A pure value.

  `Aerie.Vehicle.Collision.Detector` takes some seconds to be sure. Until then a flying vehicle must not be reported as
  landed and disarmed because another one was switched on. So while boot times, positions or types alternate, while a path
  is new, or while heartbeats on two paths differ, a change of the state counts only after it has stayed for two and a half
  seconds, in which two heartbeats come. Two links to one vehicle agree again with the second link's next heartbeat, and then the change counts at once.

  A change after a silence waits as well, until the vehicle's clock has shown whether it was restarted: that it is disarmed
  now follows from the reboot, and is reported after it.
  """

  alias Aerie.Vehicle.Collision.{Detector, Owner}

  # For how long a sign of two vehicles counts.
  @sign_us 3_000_000
  @stays_us 2_500_000
  @max_paths 32

  defstruct heartbeats: %{}, held: nil

  @typedoc "`heartbeats`: the last one of each path; `held`: the changed state, and since when it stays."
  @type t :: %__MODULE__{
          heartbeats: %{Owner.path() => {term(), integer()}},
          held: {term(), since :: integer()} | nil
        }

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "A heartbeat came by a path; `content` is what it says of the vehicle."
  @spec heartbeat(t(), Owner.path(), term(), integer()) :: t()
  def heartbeat(%{heartbeats: heartbeats} = suspicion, path, content, at) do
    heartbeats = if map_size(heartbeats) < @max_paths, do: heartbeats, else: %{}
    %{suspicion | heartbeats: Map.put(heartbeats, path, {content, at})}
  end

  @doc "Whether there may be two vehicles at this time that have not been separated yet."
  @spec two?(t(), Detector.t(), Owner.t(), integer()) :: boolean()
  def two?(suspicion, detector, owner, at) do
    differ?(suspicion.heartbeats, at) or
      (Owner.others(owner, at) == [] and
         (recent?(Detector.last_flip(detector), at) or Owner.new_path?(owner, at, @sign_us)))
  end

  defp differ?(heartbeats, _at) when map_size(heartbeats) < 2, do: false

  defp differ?(heartbeats, at) do
    fresh = for {_path, {content, heard}} <- heartbeats, at - heard <= @sign_us, do: content
    match?([_, _ | _], Enum.uniq(fresh))
  end

  defp recent?(nil, _at), do: false
  defp recent?(flipped, at), do: at - flipped <= @sign_us

  @doc """
  The state differs from the one shown last. `{:wait, suspicion}`: it has to stay first; `{:go, since, suspicion}`: it
  counts, with the time at which it began.
  """
  @spec change(t(), state :: term(), why_wait :: :two | :restart | nil, integer()) ::
          {:wait, t()} | {:go, integer(), t()}
  def change(%{held: {state, since}} = suspicion, state, why, at) do
    if why == :restart or (why == :two and at - since < @stays_us),
      do: {:wait, suspicion},
      else: {:go, since, %{suspicion | held: nil}}
  end

  def change(suspicion, _state, nil, at), do: {:go, at, %{suspicion | held: nil}}
  def change(suspicion, state, _why, at), do: {:wait, %{suspicion | held: {state, at}}}

  @doc "The vehicle was restarted, as is known since `at`: a change that is held follows from that."
  @spec rebooted(t(), integer()) :: t()
  def rebooted(%{held: {state, _since}} = suspicion, at), do: %{suspicion | held: {state, at}}
  def rebooted(suspicion, _at), do: suspicion

  @doc "The state is the one shown last."
  @spec unchanged(t()) :: t()
  def unchanged(%{held: nil} = suspicion), do: suspicion
  def unchanged(suspicion), do: %{suspicion | held: nil}
end
