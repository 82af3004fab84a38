defmodule Aerie.Bridge.Memory.Unheard do
  @moduledoc """
  Vehicles that were heard when the last life of the gateway ended, and are not heard in this one: once the time after
  which a silent vehicle is lost has passed since the start, they are told as `link.lost`, marked as found. Each once: a
  vehicle that is here by then, or was told, has a detector's state in the journal.
  """

  alias Aerie.{Config, Fleet, Names, Store}
  alias Aerie.Vehicle.{Detector, Events, HighLatency, Options}

  @type t :: %{String.t() => since :: integer()}

  @doc "Those that were known and not lost, of what is kept."
  @spec new(%{String.t() => map()}) :: t()
  def new(kept), do: for({id, %{lost: false, since: since}} <- kept, into: %{}, do: {id, since})

  @doc "It is `now` (unix us), `up_us` after the start; gives those that are still to be told."
  @spec look(t(), Names.gateway(), Config.t(), integer(), non_neg_integer()) :: t()
  def look(unheard, _gateway, _config, _now, _up_us) when unheard == %{}, do: unheard

  def look(unheard, gateway, config, now, up_us) do
    options = Options.new(config, {"any", 0})

    if up_us >= patience(gateway, options) do
      Enum.each(unheard, fn {id, since} -> tell(gateway, %{options | id: id}, now, since) end)
      %{}
    else
      unheard
    end
  end

  # By which link each was heard is not kept: where one is slow, all get the time that it takes.
  defp patience(gateway, options) do
    if Enum.any?(Store.links(gateway), &HighLatency.link?(gateway, &1.id)),
      do: max(options.lost_us, options.lost_high_latency_us),
      else: options.lost_us
  end

  defp tell(gateway, options, now, since) do
    found = Aerie.Bridge.Memory.of(gateway, options.id)
    detector = options |> Detector.new() |> Detector.remember(found)
    {detector, events, %{}} = Detector.observe(detector, {:unheard, now, since})

    if Fleet.Journal.begin_gone(gateway, options.id, detector, events),
      do: Enum.each(events, &Events.told(gateway, options.id, &1))
  end
end
