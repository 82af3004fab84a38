defmodule Aerie.Router.Owner do
  @moduledoc """
  The rules of a link or a client, which hold for all its peers: whose frames it sees, and how much of them.

  | option | |
  |---|---|
  | `:side` | `:vehicle` (a link to vehicles; default) or `:client` |
  | `:networks` | names, in order of precedence, or `:all`, those too that are added later; a link's is `["main"]` unless said, a client sees all |
  | `:group` | redundant ways to the same vehicles share a group: nothing goes from one to another of it, and what goes to a vehicle goes by one of them (`Aerie.Router.Score`) |
  | `:carry` | which one of the group: `%{class => link id | :all}`; else the best one |
  | `:role` | `:full` or `:read_only`: nothing that it says goes to anyone |
  | `:sniffer` | true: it gets every frame of its networks, whoever is addressed |
  | `:in`, `:out` | filters (`Aerie.Router.Filter`) |
  | `:rate_limits` | `%{message => Hz}` (`Aerie.Router.RateLimit`) |
  | `:bytes_per_s` | budget of what goes out to each of its peers; default none, a serial line's own |
  | `:queue` | `[max_frames:, max_bytes:, max_asked:]` of what waits for one peer (`Aerie.Router.Queue`) |
  | `:coalesce` | frames may share a datagram when many wait (`Aerie.Router.Out`); default true |
  | `:sign` | of a client, true: what it sends unsigned is believed, and signed for vehicles that ask for it (`Aerie.Signing`) |
  | `:gcs` | of a link: which of its ends may command vehicles, `:auto`, `:allow` or `:deny` (`Aerie.Router.Gate`) |
  | `:broadcasts` | false: only what is addressed to it; default true |
  | `:id_offsets` | system ids of a network plus a number, for a client: `%{network => n}` (`Aerie.Router.Renumber`) |
  | `:high_latency` | true: only what a link of high latency carries goes to it (X6), unless `:out` says itself which messages may |
  """

  alias Aerie.Router.Classify
  alias Aerie.Router.Filter
  alias Aerie.Router.RateLimit
  alias Aerie.Router.Renumber

  @enforce_keys [:id]
  defstruct [
    :id,
    :group,
    :in,
    :out,
    :limits,
    :renumber,
    :bytes_per_s,
    side: :vehicle,
    gcs: :auto,
    networks: ["main"],
    carry: %{},
    role: :full,
    sniffer: false,
    sign: false,
    queue: [],
    coalesce: true,
    broadcasts: true,
    high_latency: false,
    options: [],
    configured: []
  ]

  @typedoc "`in`, `out`, `limits`, `renumber` are compiled; `options` is what it was made of, `configured` what it was made of first."
  @type t :: %__MODULE__{
          id: String.t(),
          group: String.t() | nil,
          in: Filter.t(),
          out: Filter.t(),
          limits: RateLimit.t(),
          renumber: Renumber.t(),
          bytes_per_s: pos_integer | nil,
          side: :vehicle | :client,
          gcs: :auto | :allow | :deny,
          networks: [String.t()] | :all,
          carry: %{Classify.class() => String.t() | :all},
          role: :full | :read_only,
          sniffer: boolean,
          sign: boolean,
          queue: keyword,
          coalesce: boolean,
          broadcasts: boolean,
          high_latency: boolean,
          options: keyword,
          configured: keyword
        }

  @keys [:side, :networks, :group, :carry, :role, :sniffer, :in, :out, :rate_limits, :bytes_per_s, :queue] ++
          [:coalesce, :broadcasts, :high_latency, :sign, :id_offsets, :gcs]

  @doc "The keys of options."
  @spec keys() :: [atom]
  def keys, do: @keys

  @doc "Checks and compiles options; the error is words."
  @spec new(String.t(), keyword | map) :: {:ok, t} | {:error, String.t()}
  def new(id, options) do
    options = Enum.reject(options, fn {_key, value} -> is_nil(value) end)
    networks = if options[:side] == :client, do: :all, else: ["main"]

    owner = %__MODULE__{id: id, networks: networks, options: options, configured: options}

    Enum.reduce_while(options, {:ok, owner}, fn {key, value}, {:ok, owner} ->
      case option(key, value) do
        {:ok, fields} -> {:cont, {:ok, struct!(owner, fields)}}
        {:error, words} -> {:halt, {:error, "#{key}: #{words}"}}
      end
    end)
    |> whole()
  end

  # Who comes by a radio must sign for himself.
  defp whole({:ok, %{sign: true, side: :vehicle}}), do: {:error, "sign: only a client can be signed for"}
  defp whole(result), do: result

  defp option(:side, side) when side in [:vehicle, :client], do: {:ok, side: side}
  defp option(:role, role) when role in [:full, :read_only], do: {:ok, role: role}
  defp option(:gcs, gcs) when gcs in [:auto, :allow, :deny], do: {:ok, gcs: gcs}
  defp option(:group, group) when is_binary(group), do: {:ok, group: group}
  defp option(:bytes_per_s, n) when is_integer(n) and n > 0, do: {:ok, bytes_per_s: n}

  defp option(key, flag)
       when key in [:sniffer, :coalesce, :broadcasts, :high_latency, :sign] and is_boolean(flag),
       do: {:ok, [{key, flag}]}

  defp option(key, spec) when key in [:in, :out],
    do: with({:ok, f} <- Filter.compile(spec), do: {:ok, [{key, f}]})

  defp option(:rate_limits, rates),
    do: with({:ok, limits} <- RateLimit.compile(rates), do: {:ok, limits: limits})

  defp option(:id_offsets, offsets),
    do: with({:ok, renumber} <- Renumber.compile(offsets), do: {:ok, renumber: renumber})

  defp option(:networks, :all), do: {:ok, networks: :all}

  defp option(:networks, [_ | _] = names) do
    if Enum.all?(names, &is_binary/1),
      do: {:ok, networks: Enum.uniq(names)},
      else: {:error, "names of networks"}
  end

  defp option(:carry, carry) when is_map(carry) do
    if Enum.all?(carry, fn {class, link} ->
         class in Classify.classes() and (link == :all or is_binary(link))
       end),
       do: {:ok, carry: carry},
       else: {:error, "classes with links or :all"}
  end

  defp option(:queue, queue) when is_list(queue) do
    if Enum.all?(
         queue,
         &match?({key, n} when key in [:max_frames, :max_bytes, :max_asked] and is_integer(n) and n > 0, &1)
       ),
       do: {:ok, queue: queue},
       else: {:error, "max_frames, max_bytes and max_asked above 0"}
  end

  defp option(key, value) when key in @keys, do: {:error, "#{inspect(value, limit: 5)} is not allowed"}
  defp option(_key, _value), do: {:error, "no such option"}
end
