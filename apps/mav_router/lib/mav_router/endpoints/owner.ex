defmodule MavRouter.Endpoints.Owner do
  @moduledoc """
  The rules of a link or a client, which hold for all its peers: which frames it gets, and how many.

  | option | |
  |---|---|
  | `:side` | `:vehicle` (a link to vehicles; default) or `:client` |
  | `:networks` | names in order of precedence, or `:all`, later ones included; default the gateway's own for a link, `:all` for a client |
  | `:group` | redundant links to the same vehicles share a group: nothing goes from one to another, and one of them carries what goes to a vehicle (`MavRouter.Routes.LinkSelector`) |
  | `:carry` | which link of the group carries a class: `%{class => link id | :all}`; default the best one |
  | `:role` | `:full` or `:read_only`: its frames go to nobody |
  | `:sniffer` | true: it gets every frame of its networks, whatever the target |
  | `:served` | of a client, true: what it reads of parameters and plans may be answered by the gateway (`MavRouter.Sharing.ReadCache`) |
  | `:in`, `:out` | filters (`MavRouter.Endpoints.Owner.Filter`) |
  | `:rate_limits` | `%{message => Hz}` (`MavRouter.Endpoints.Owner.RateLimit`) |
  | `:bytes_per_s` | budget of what goes out to each of its peers; default none, for a serial line its rate |
  | `:queue` | `[max_frames:, max_bytes:, max_asked:]` of what waits for one peer (`MavRouter.Endpoints.Queue.ClassQueue`) |
  | `:coalesce` | frames may share a datagram when many wait (`MavRouter.Endpoints.Output`); default true |
  | `:sign` | of a client, true: its unsigned frames are trusted, and signed for vehicles that require it (`MavRouter.Signing`) |
  | `:gcs` | of a link: which of its endpoints count as clients, `:auto`, `:allow` or `:deny` (`MavRouter.Endpoints.Access`) |
  | `:parts` | of a link, true: cameras, gimbals and companions of its vehicles are on it, and tell their autopilots what they have to tell (`MavRouter.Forward.Reach`) |
  | `:broadcasts` | false: it gets only frames with its ids as target; default true |
  | `:id_offsets` | for a client, what is added to the system ids of a network: `%{network => n}` (`MavRouter.Endpoints.Owner.Renumber`) |
  | `:high_latency` | true: it gets only what a link of high latency carries (X6), unless `:out` lists the messages |
  """

  alias Aerie.Base.Json
  alias MavRouter.Endpoints.Queue.TrafficClass
  alias MavRouter.Endpoints.Owner.Filter
  alias MavRouter.Endpoints.Owner.RateLimit
  alias MavRouter.Endpoints.Owner.Renumber

  @enforce_keys [:id]
  defstruct [
    :id,
    :group,
    :in,
    :out,
    :limits,
    :renumber,
    :bytes_per_s,
    :networks,
    side: :vehicle,
    gcs: :auto,
    carry: %{},
    role: :full,
    sniffer: false,
    served: false,
    sign: false,
    parts: false,
    queue: [],
    coalesce: true,
    broadcasts: true,
    high_latency: false,
    options: [],
    configured: []
  ]

  @typedoc "`in`, `out`, `limits`, `renumber` are compiled; `options` are those that it was made of, `configured` those of the configuration."
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
          carry: %{TrafficClass.class() => String.t() | :all},
          role: :full | :read_only,
          sniffer: boolean,
          served: boolean,
          sign: boolean,
          queue: keyword,
          coalesce: boolean,
          broadcasts: boolean,
          high_latency: boolean,
          options: keyword,
          configured: keyword
        }

  @keys [
          :side,
          :networks,
          :group,
          :carry,
          :role,
          :sniffer,
          :served,
          :in,
          :out,
          :rate_limits,
          :bytes_per_s,
          :queue
        ] ++
          [:coalesce, :broadcasts, :high_latency, :sign, :id_offsets, :gcs, :parts]

  @doc "Checks and compiles options; the error is a text."
  @spec new(String.t(), keyword | map) :: {:ok, t} | {:error, String.t()}
  def new(id, options) do
    options = Enum.reject(options, fn {_key, value} -> is_nil(value) end)
    networks = if options[:side] == :client, do: :all, else: [MavRouter.Identity.default_network()]

    owner = %__MODULE__{id: id, networks: networks, options: options, configured: options}

    Enum.reduce_while(options, {:ok, owner}, fn {key, value}, {:ok, owner} ->
      case option(key, value) do
        {:ok, fields} -> {:cont, {:ok, struct!(owner, fields)}}
        {:error, words} -> {:halt, {:error, "#{key}: #{words}"}}
      end
    end)
    |> consistent()
  end

  # A sender behind a radio must sign for itself.
  defp consistent({:ok, %{sign: true, side: :vehicle}}), do: {:error, "sign: only a client can be signed for"}
  defp consistent(result), do: result

  defp option(:side, side) when side in [:vehicle, :client], do: {:ok, side: side}
  defp option(:role, role) when role in [:full, :read_only], do: {:ok, role: role}
  defp option(:gcs, gcs) when gcs in [:auto, :allow, :deny], do: {:ok, gcs: gcs}
  defp option(:group, group) when is_binary(group), do: {:ok, group: group}
  defp option(:bytes_per_s, n) when is_integer(n) and n > 0, do: {:ok, bytes_per_s: n}

  defp option(key, flag)
       when key in [:sniffer, :served, :coalesce, :broadcasts, :high_latency, :sign, :parts] and
              is_boolean(flag),
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
      else: {:error, "expected names of networks"}
  end

  defp option(:carry, carry) when is_map(carry) do
    if Enum.all?(carry, fn {class, link} ->
         class in TrafficClass.classes() and (link == :all or is_binary(link))
       end),
       do: {:ok, carry: carry},
       else: {:error, "expected classes with a link or :all"}
  end

  defp option(:queue, queue) when is_list(queue) do
    if Enum.all?(
         queue,
         &match?({key, n} when key in [:max_frames, :max_bytes, :max_asked] and is_integer(n) and n > 0, &1)
       ),
       do: {:ok, queue: queue},
       else: {:error, "expected max_frames, max_bytes and max_asked above 0"}
  end

  defp option(key, value) when key in @keys, do: {:error, "#{Json.shown(value, 60)} is not allowed"}
  defp option(_key, _value), do: {:error, "no such option"}
end
