defmodule Aerie.Console.Pages.Links.View do
  @moduledoc "Links, endpoints, routes and rules for the page, from the read model; and a link's history. Pure."

  alias MavRouter.Client

  @max_rows 200
  @samples 120

  @typedoc "A sample of a link: rates per second, loss 0..1 and round trip in ms, nil if not known."
  @type sample :: %{frames: number(), bytes: number(), loss: number() | nil, rtt: number() | nil}

  @doc "A link's row. `now` in unix microseconds."
  @spec link(map(), integer()) :: map()
  def link(link, now) do
    quality = link[:quality] || %{}
    rates = link[:rates] || %{}

    %{
      id: link.id,
      network: link.network,
      label: link[:label],
      url: link.url,
      status: link.status,
      text: link.text,
      in: rates[:frames_in] || 0,
      bytes_in: rates[:bytes_in] || 0,
      bytes_out: rates[:bytes_out] || 0,
      loss: quality[:loss],
      rtt: quality[:rtt_ms],
      score: quality[:score],
      carries: quality[:carries],
      group: quality[:group],
      age_us: link[:last_heard] && max(now - link.last_heard, 0),
      dropped: dropped(link[:counters])
    }
  end

  @drops [:unclaimed, :overload, :refused, :dropped_out, :kernel_dropped, :shed, :shed_new, :peers_refused]

  defp dropped(nil), do: 0
  defp dropped(counters), do: @drops |> Enum.map(&(Map.get(counters, &1) || 0)) |> Enum.sum()

  @doc "A link as lines of the configuration's file."
  @spec configuration(map()) :: String.t()
  def configuration(link) do
    pairs =
      for key <- [:id, :url, :network, :label], is_binary(link[key]), do: "#{key}: #{JSON.encode!(link[key])}"

    "links:\n  - {#{Enum.join(pairs, ", ")}}\n"
  end

  @doc "The non-zero counters of a link by name, without those by message."
  @spec counters(map()) :: [{String.t(), non_neg_integer()}]
  def counters(%{counters: counters}) do
    plain = if is_struct(counters), do: Map.from_struct(counters), else: counters
    for {name, n} <- Enum.sort(plain), is_integer(n) and n > 0, do: {Atom.to_string(name), n}
  end

  @doc "An endpoint's row."
  @spec endpoint(map(), non_neg_integer()) :: map()
  def endpoint(endpoint, n) do
    dropped =
      for {name, count} <- Enum.sort(endpoint.counters),
          name not in [:frames_in, :frames_out, :bytes_out],
          count > 0,
          do: "#{name} #{count}"

    %{
      id: "endpoint-#{n}",
      owner: endpoint.owner,
      peer: endpoint.peer,
      side: endpoint.side,
      kind: endpoint.kind,
      networks: endpoint.networks,
      role: endpoint.role,
      waiting: endpoint.waiting,
      in: endpoint.rates.frames_in,
      out: endpoint.rates.frames_out,
      bytes_out: endpoint.rates.bytes_out,
      dropped: Client.dropped(endpoint),
      notes: Enum.join(dropped, ", ")
    }
  end

  @doc "The routes by network, system and component, and how many more there are."
  @spec routes([map()]) :: {[map()], non_neg_integer()}
  def routes(routes) do
    sorted = Enum.sort_by(routes, &{&1.network, &1.system, &1.component, &1.link, inspect(&1.peer)})

    rows =
      for {route, n} <- sorted |> Enum.take(@max_rows) |> Enum.with_index(),
          do: %{route | peer: peer(route.peer)} |> Map.put(:id, "route-#{n}")

    {rows, max(length(routes) - @max_rows, 0)}
  end

  defp peer({address, port}) when is_tuple(address), do: Aerie.Base.Net.Address.format(address, port)
  defp peer(other), do: inspect(other, limit: 4)

  @doc "The links and vehicles of each network."
  @spec networks([map()], [map()]) :: [%{name: String.t(), links: [String.t()], vehicles: non_neg_integer()}]
  def networks(links, vehicles) do
    count = Enum.frequencies_by(vehicles, & &1.network)

    for {name, links} <- links |> Enum.group_by(& &1.network) |> Enum.sort(),
        do: %{name: name, links: links |> Enum.map(& &1.id) |> Enum.sort(), vehicles: Map.get(count, name, 0)}
  end

  @doc "The loss for each component that a link hears, the worst first."
  @spec sources(map()) :: [
          %{id: String.t(), received: non_neg_integer(), lost: non_neg_integer(), ratio: float() | nil}
        ]
  def sources(link) do
    for {{system, component}, stats} <- link.sources do
      %{id: "#{system}/#{component}", received: stats.received, lost: stats.lost, ratio: stats.ratio}
    end
    |> Enum.sort_by(&{-(&1.ratio || 0), &1.id})
    |> Enum.take(@max_rows)
  end

  @doc "Adds a sample to a link's, newest first, at most two minutes."
  @spec sampled([sample()], map()) :: [sample()]
  def sampled(samples, link) do
    row = link(link, 0)
    Enum.take([%{frames: row.in, bytes: row.bytes_in, loss: row.loss, rtt: row.rtt} | samples], @samples)
  end

  @doc "The points of a line in a field of 120 by 30, newest at the right, or nil. `least` is the smallest range of the scale."
  @spec line([sample()], atom(), number()) :: %{points: String.t(), top: number()} | nil
  def line(samples, key, least) do
    values = for {sample, n} <- Enum.with_index(samples), value = sample[key], do: {@samples - n, value}

    if values != [] do
      top = values |> Enum.map(&elem(&1, 1)) |> Enum.max() |> max(least)
      points = for {x, value} <- values, do: "#{x},#{Float.round(29 - 28 * value / top, 2)}"
      %{points: points |> Enum.reverse() |> Enum.join(" "), top: top}
    end
  end
end
