defmodule Aerie.Vehicle.HighLatency do
  @moduledoc """
  Links of high latency: satellite modems and the like, where a byte costs money and minutes (X6). A pure value for one
  vehicle.

  A link is one when it is configured so (`links[].high_latency`), or when HIGH_LATENCY2 comes by it and no heartbeat does.
  Over it go commands and their answers, no heartbeats, streams, parameters, missions or clock measurements (`Aerie.Mavlink.HighLatency`).
  While a vehicle is heard by such links only it is asked for nothing, and is lost after
  `timeouts.vehicle_lost_high_latency_s` instead of seconds.
  """

  alias Aerie.Mavlink.HighLatency, as: Rules
  alias Aerie.Names
  alias MavCodec.Messages.CommandLong

  @control_high_latency 2600
  @max_links 32

  defstruct links: %{}

  @typedoc "By link: whether it is configured so, and when a summary and a heartbeat of the vehicle came by it last."
  @type t :: %__MODULE__{
          links: %{
            term() => %{
              marked: boolean(),
              summary: integer() | nil,
              beat: integer() | nil
            }
          }
        }

  @doc "Nothing known, or what a snapshot's `high_latency` showed at a time."
  @spec new(map() | nil, integer() | nil) :: t()
  def new(shown \\ nil, at \\ nil)

  def new(%{links: links}, at), do: %__MODULE__{links: Map.new(links, &{&1, %{entry() | summary: at}})}

  def new(_nothing, _at), do: %__MODULE__{}

  defp entry, do: %{marked: false, summary: nil, beat: nil}

  @doc "A link is, or is not, configured to be one of high latency."
  @spec marked(t(), term(), boolean()) :: t()
  def marked(high, link, marked?) do
    if marked? or is_map_key(high.links, link), do: update(high, link, &%{&1 | marked: marked?}), else: high
  end

  @doc "HIGH_LATENCY2 came by a link."
  @spec summary(t(), term(), integer()) :: t()
  def summary(high, link, at), do: update(high, link, &%{&1 | summary: at})

  @doc "The autopilot's heartbeat came by a link."
  @spec beat(t(), term(), integer()) :: t()
  def beat(high, link, at), do: update(high, link, &%{&1 | beat: at})

  @doc "Time goes on from `now`."
  @spec rebased(t(), integer()) :: t()
  def rebased(high, now) do
    links =
      Map.new(high.links, fn {link, entry} ->
        {link, %{entry | summary: entry.summary && now, beat: entry.beat && now}}
      end)

    %{high | links: links}
  end

  @doc "The clock was set by `step`."
  @spec shifted(t(), integer()) :: t()
  def shifted(high, step) do
    links =
      Map.new(high.links, fn {link, entry} ->
        {link,
         %{entry | summary: entry.summary && entry.summary + step, beat: entry.beat && entry.beat + step}}
      end)

    %{high | links: links}
  end

  defp update(%{links: links} = high, link, fun) do
    if is_map_key(links, link) or map_size(links) < @max_links,
      do: %{high | links: Map.put(links, link, fun.(Map.get(links, link, entry())))},
      else: high
  end

  @doc "Whether a link is one of high latency."
  @spec high?(t(), term()) :: boolean()
  def high?(%{links: links}, link) do
    case links do
      %{^link => %{marked: true}} -> true
      %{^link => %{summary: nil}} -> false
      %{^link => %{beat: nil}} -> true
      %{^link => %{summary: summary, beat: beat}} -> summary - beat > Rules.silent_us()
      _ordinary -> false
    end
  end

  @doc "The links that are."
  @spec links(t()) :: [term()]
  def links(high), do: for({link, _entry} <- high.links, high?(high, link), do: link) |> Enum.sort()

  @doc """
  Whether a vehicle that was heard by these links (the time of each) can, at `now`, be reached by links of high latency
  only: it has one, and was heard by no other within `lost_us`.
  """
  @spec only?(t(), [{term(), integer() | nil}], integer(), pos_integer()) :: boolean()
  def only?(high, heard, now, lost_us) do
    links(high) != [] and
      not Enum.any?(heard, fn {link, at} -> at != nil and now - at < lost_us and not high?(high, link) end)
  end

  @doc "When the vehicle was heard last by a link of high latency; nil for never."
  @spec last(t()) :: integer() | nil
  def last(high) do
    times = for {link, entry} <- high.links, high?(high, link), do: max(entry.summary || 0, entry.beat || 0)
    if times != [], do: Enum.max(times)
  end

  @doc """
  By which link to send what is not for links of high latency: `:any` when none is one, `:none` when there is no other.
  """
  @spec way(t(), [{term(), integer() | nil}]) :: :any | {:link, term()} | :none
  def way(high, heard) do
    others = Enum.reject(heard, fn {link, _at} -> high?(high, link) end)

    cond do
      links(high) == [] -> :any
      others == [] -> :none
      true -> {:link, others |> Enum.max_by(fn {_link, at} -> at || 0 end) |> elem(0)}
    end
  end

  @doc "Whether a vehicle says that a link of its is one of high latency, or the configuration does."
  @spec link?(Names.gateway(), link :: term()) :: boolean()
  def link?(gateway, link) do
    match?(%{high_latency: true}, Aerie.Store.link(gateway, link))
  end

  @doc "MAV_CMD_CONTROL_HIGH_LATENCY: the vehicle begins, or ceases, to send HIGH_LATENCY2."
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
  Sends that command to a vehicle by the way that it was heard last, once and without waiting for its answer.
  `{:error, :unknown}` for a vehicle that has no session.
  """
  @spec request(Names.gateway(), Aerie.Store.vehicle_key(), boolean()) :: :ok | {:error, :unknown}
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
