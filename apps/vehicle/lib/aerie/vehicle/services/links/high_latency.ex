defmodule Aerie.Vehicle.Services.Links.HighLatency do
  @moduledoc """
  Which of a vehicle's links have a high latency: satellite modems and the like, where each byte costs money and minutes
  (X6). A pure value.

  A link is one if the configuration says so (`links[].high_latency`), or if HIGH_LATENCY2 comes by it and no heartbeat does.
  It carries commands and their answers, but no heartbeats, streams, parameters, missions or clock measurements
  (`MavCodec.Meaning.HighLatency`). A vehicle that is heard only by such links is sent no requests, and is lost after
  `timeouts.vehicle_lost_high_latency_s` instead of a few seconds.
  """

  alias MavCodec.Meaning.HighLatency, as: Rules
  alias Aerie.Base.Names
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages.CommandLong

  @control_high_latency MavCmd.value(:MAV_CMD_CONTROL_HIGH_LATENCY)
  @max_links 32

  defstruct links: %{}, high: []

  @typedoc """
  By link: whether it is configured so, and when the vehicle's last summary and last heartbeat came by it. `high` are those that follow from
  it to be high-latency links, which every tick asks for.
  """
  @type t :: %__MODULE__{
          links: %{
            term() => %{
              configured: boolean(),
              summary: integer() | nil,
              heartbeat: integer() | nil
            }
          },
          high: [term()]
        }

  @doc "Nothing known, or what a snapshot's `high_latency` showed `at` a time."
  @spec new(map() | nil, integer() | nil) :: t()
  def new(shown \\ nil, at \\ nil)

  def new(%{links: links}, at), do: with_links(Map.new(links, &{&1, %{entry() | summary: at}}))
  def new(_nothing, _at), do: %__MODULE__{}

  defp entry, do: %{configured: false, summary: nil, heartbeat: nil}

  defp with_links(links),
    do: %__MODULE__{links: links, high: Enum.sort(for {link, entry} <- links, high?(entry), do: link)}

  defp high?(%{configured: true}), do: true
  defp high?(%{summary: nil}), do: false
  defp high?(%{heartbeat: nil}), do: true
  defp high?(%{summary: summary, heartbeat: heartbeat}), do: summary - heartbeat > Rules.silent_us()

  @doc "A link is, or is not, configured as a high-latency link."
  @spec configured(t(), term(), boolean()) :: t()
  def configured(high, link, configured?) do
    if configured? or is_map_key(high.links, link),
      do: update(high, link, &%{&1 | configured: configured?}),
      else: high
  end

  @doc "HIGH_LATENCY2 came by a link."
  @spec summary(t(), term(), integer()) :: t()
  def summary(high, link, at), do: update(high, link, &%{&1 | summary: at})

  @doc "The autopilot's heartbeat came by a link."
  @spec heartbeat(t(), term(), integer()) :: t()
  def heartbeat(high, link, at), do: update(high, link, &%{&1 | heartbeat: at})

  @doc "Time goes on from `now`, which is not comparable with the time before."
  @spec rebased(t(), integer()) :: t()
  def rebased(high, now), do: times(high, fn _at -> now end)

  @doc "The clock was set by `step` (us)."
  @spec shifted(t(), integer()) :: t()
  def shifted(high, step), do: times(high, &(&1 + step))

  defp times(high, fun) do
    with_links(
      Map.new(high.links, fn {link, %{summary: summary, heartbeat: heartbeat} = entry} ->
        {link, %{entry | summary: summary && fun.(summary), heartbeat: heartbeat && fun.(heartbeat)}}
      end)
    )
  end

  defp update(%{links: links} = high, link, fun) do
    if is_map_key(links, link) or map_size(links) < @max_links,
      do: with_links(Map.put(links, link, fun.(Map.get(links, link, entry())))),
      else: high
  end

  @doc "Whether a link is a high-latency link."
  @spec high_latency?(t(), term()) :: boolean()
  def high_latency?(%{high: high}, link), do: link in high

  @doc "The high-latency links, sorted."
  @spec links(t()) :: [term()]
  def links(%{high: high}), do: high

  @doc """
  Whether a vehicle can only be reached by high-latency links: it has one, and no other link has heard it within `lost_us`.
  `heard` has the time at which each link last heard it.
  """
  @spec only?(t(), [{term(), integer() | nil}], integer(), pos_integer()) :: boolean()
  def only?(%{high: []}, _heard, _now, _lost_us), do: false

  def only?(high, heard, now, lost_us) do
    not Enum.any?(heard, fn {link, at} ->
      at != nil and now - at < lost_us and not high_latency?(high, link)
    end)
  end

  @doc "When a high-latency link last heard the vehicle; nil for never."
  @spec last(t()) :: integer() | nil
  def last(high) do
    times =
      for link <- high.high,
          %{summary: summary, heartbeat: heartbeat} = high.links[link],
          do: max(summary || 0, heartbeat || 0)

    Enum.max(times, fn -> nil end)
  end

  @doc """
  By which link to send what is not for high-latency links: `:any` if no link is one, `:none` if all are.
  """
  @spec other_link(t(), [{term(), integer() | nil}]) :: :any | {:link, term()} | :none
  def other_link(%{high: []}, _heard), do: :any

  def other_link(high, heard) do
    case Enum.reject(heard, fn {link, _at} -> high_latency?(high, link) end) do
      [] -> :none
      others -> {:link, others |> Enum.max_by(fn {_link, at} -> at || 0 end) |> elem(0)}
    end
  end

  @doc "Whether the configuration of a link says that it is a high-latency link."
  @spec link?(Names.gateway(), link :: term()) :: boolean()
  def link?(gateway, link), do: match?(%{high_latency: true}, Aerie.Base.Store.link(gateway, link))

  @doc "MAV_CMD_CONTROL_HIGH_LATENCY: makes the vehicle start or stop sending HIGH_LATENCY2."
  @spec control(target :: {integer(), integer()}, boolean()) :: CommandLong.t()
  def control({system, component}, on?) do
    %CommandLong{
      target_system: system,
      target_component: component,
      command: @control_high_latency,
      param1: if(on?, do: 1.0, else: 0.0)
    }
  end

  @doc """
  Sends that command to a vehicle once, by the path that it was last heard on, without waiting for the answer.
  `{:error, :unknown}` for a vehicle that has no session.
  """
  @spec request(Names.gateway(), Aerie.Base.Store.vehicle_key(), boolean()) :: :ok | {:error, :unknown}
  def request(gateway, key, on?) do
    case Names.whereis(gateway, :session, key) do
      nil ->
        {:error, :unknown}

      session ->
        send(session, {:high_latency, on?})
        :ok
    end
  end
end
