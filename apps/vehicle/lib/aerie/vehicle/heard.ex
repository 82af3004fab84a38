defmodule Aerie.Vehicle.Heard do
  @moduledoc """
  On which links a vehicle is heard, how much, and since when not: the `:link` group. A pure value.

  Rates are counted over the last whole second or more. A link that was silent for a minute is forgotten.
  """

  defstruct links: %{}, since: nil, frames: 0, bytes: 0

  @forget_us 60_000_000
  @max_links 32

  @type t :: %__MODULE__{}

  @doc "Nothing heard yet; or, after a restart, these links at this time."
  @spec new([term()], integer() | nil) :: t()
  def new(links \\ [], at \\ nil), do: %__MODULE__{links: Map.new(links, &{&1, at})}

  @doc "The clock was set by `step`."
  @spec shifted(t(), integer()) :: t()
  def shifted(heard, step) do
    links = Map.new(heard.links, fn {link, at} -> {link, at && at + step} end)
    %{heard | links: links, since: heard.since && heard.since + step}
  end

  @doc "A frame from a link."
  @spec frame(t(), term(), non_neg_integer(), integer()) :: t()
  def frame(heard, link, bytes, at) do
    links =
      if is_map_key(heard.links, link) or map_size(heard.links) < @max_links,
        do: Map.put(heard.links, link, at),
        else: heard.links

    %{heard | links: links, frames: heard.frames + 1, bytes: heard.bytes + bytes, since: heard.since || at}
  end

  @doc "Forgets links by which it was not this vehicle that was heard."
  @spec without(t(), [term()]) :: t()
  def without(heard, links), do: %{heard | links: Map.drop(heard.links, links)}

  @doc "Links that the vehicle is heard on, the latest first."
  @spec links(t()) :: [term()]
  def links(heard) do
    heard.links |> Enum.sort_by(fn {link, at} -> {-(at || 0), link} end) |> Enum.map(&elem(&1, 0))
  end

  @doc "When the vehicle was heard last by each link."
  @spec times(t()) :: [{term(), integer() | nil}]
  def times(heard), do: Map.to_list(heard.links)

  @doc "The data of the `:link` group, once a second; nil in between."
  @spec measure(t(), integer()) :: {t(), map() | nil}
  def measure(%{since: nil} = heard, _now), do: {heard, nil}
  def measure(%{since: since} = heard, now) when now - since < 1_000_000, do: {heard, nil}

  def measure(heard, now) do
    links = Map.filter(heard.links, fn {_link, at} -> at != nil and now - at < @forget_us end)
    seconds = (now - heard.since) / 1_000_000
    heard = %{heard | links: links}

    data = %{
      frames_per_s: Float.round(heard.frames / seconds, 1),
      bytes_per_s: Float.round(heard.bytes / seconds, 1),
      links: links(heard)
    }

    {%{heard | since: now, frames: 0, bytes: 0}, data}
  end
end
