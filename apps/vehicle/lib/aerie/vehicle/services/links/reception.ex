defmodule Aerie.Vehicle.Services.Links.Reception do
  @moduledoc """
  On which links a vehicle is heard, when last, and at which rates: the `:link` group. A pure value.

  Rates are measured over a second or a little more. A link that was silent for a minute, and for as long as makes a
  vehicle lost on it, is forgotten.
  """

  defstruct links: %{}, since: nil, frames: 0, bytes: 0

  @forget_us 60_000_000
  @max_links 32

  @type t :: %__MODULE__{}

  @doc "Nothing heard yet; after a restart, these links at this time."
  @spec new([term()], integer() | nil) :: t()
  def new(links \\ [], at \\ nil), do: %__MODULE__{links: Map.new(links, &{&1, at})}

  @doc "The clock was set by `step` (us)."
  @spec shifted(t(), integer()) :: t()
  def shifted(reception, step) do
    links = Map.new(reception.links, fn {link, at} -> {link, at && at + step} end)
    %{reception | links: links, since: reception.since && reception.since + step}
  end

  @doc "A frame of so many bytes came by a link."
  @spec frame(t(), term(), non_neg_integer(), integer()) :: t()
  def frame(reception, link, bytes, at) do
    links =
      if is_map_key(reception.links, link) or map_size(reception.links) < @max_links,
        do: Map.put(reception.links, link, at),
        else: reception.links

    %{
      reception
      | links: links,
        frames: reception.frames + 1,
        bytes: reception.bytes + bytes,
        since: reception.since || at
    }
  end

  @doc "Forgets links on which another vehicle was heard."
  @spec without(t(), [term()]) :: t()
  def without(reception, links), do: %{reception | links: Map.drop(reception.links, links)}

  @doc "The links that the vehicle is heard on, the latest first."
  @spec links(t()) :: [term()]
  def links(%{links: links}) when map_size(links) < 2, do: Map.keys(links)

  def links(reception) do
    reception.links |> Enum.sort_by(fn {link, at} -> {-(at || 0), link} end) |> Enum.map(&elem(&1, 0))
  end

  @doc "When each link last heard the vehicle."
  @spec times(t()) :: [{term(), integer() | nil}]
  def times(reception), do: Map.to_list(reception.links)

  @doc """
  The data of the `:link` group once a second, nil in between. `lost_us` says after which silence of a link a vehicle is
  lost on it.
  """
  @spec measure(t(), integer(), (term() -> pos_integer())) :: {t(), map() | nil}
  def measure(%{since: nil} = reception, _now, _lost_us), do: {reception, nil}
  def measure(%{since: since} = reception, now, _lost_us) when now - since < 1_000_000, do: {reception, nil}

  def measure(reception, now, lost_us) do
    links =
      Map.filter(reception.links, fn {link, at} ->
        at != nil and now - at < max(@forget_us, lost_us.(link))
      end)

    seconds = (now - reception.since) / 1_000_000
    reception = %{reception | links: links}

    data = %{
      frames_per_s: Float.round(reception.frames / seconds, 1),
      bytes_per_s: Float.round(reception.bytes / seconds, 1),
      links: links(reception)
    }

    {%{reception | since: now, frames: 0, bytes: 0}, data}
  end
end
