defmodule Aerie.Fleet.Bridge.State.LastPublished.Missing do
  @moduledoc """
  Vehicles that were heard when the gateway stopped, and have not been heard since its restart. Once the time-out for a silent
  vehicle has passed since the start, each gives one `link.lost`, marked as found. A vehicle that was heard by then, or
  already has that event, has a detector's state in the journal.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Vehicle.{Events, Options, Settings}
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.Observation
  alias Aerie.Vehicle.Services.Links.HighLatency

  @type t :: %{String.t() => since :: integer()}

  @doc "The vehicles of the file that were known and not lost."
  @spec new(%{String.t() => map()}) :: t()
  def new(kept), do: for({id, %{lost: false, since: since}} <- kept, into: %{}, do: {id, since})

  @doc "Checks at `now` (unix us), `up_us` after the start; returns the vehicles that are still missing."
  @spec check(t(), Names.gateway(), Settings.t(), integer(), non_neg_integer()) :: t()
  def check(unheard, _gateway, _settings, _now, _up_us) when unheard == %{}, do: unheard

  def check(unheard, gateway, settings, now, up_us) do
    options = Options.new(settings, {"any", 0})

    if up_us >= patience(gateway, options) do
      Enum.each(unheard, fn {id, since} -> report(gateway, %{options | id: id}, now, since) end)
      %{}
    else
      unheard
    end
  end

  # The file does not say by which link a vehicle was heard. If one link has high latency, all vehicles get its time-out.
  defp patience(gateway, options) do
    if Enum.any?(Store.links(gateway), &HighLatency.link?(gateway, &1.id)),
      do: max(options.lost_us, options.lost_high_latency_us),
      else: options.lost_us
  end

  defp report(gateway, options, now, since) do
    found = Aerie.Fleet.Bridge.State.LastPublished.of(gateway, options.id)
    detector = options |> Detector.new() |> Detector.remember(found)
    {detector, events, %{}} = Detector.observe(detector, Observation.new(:unheard, now, nil, since))

    if Journal.begin_gone(gateway, options.id, detector, events),
      do: Enum.each(events, &Events.committed(gateway, options.id, &1))
  end
end
