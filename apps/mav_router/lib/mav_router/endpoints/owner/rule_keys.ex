defmodule MavRouter.Endpoints.Owner.RuleKeys do
  @moduledoc """
  The keys of the configuration that are rules of an owner (`links` and `clients`, see `config/gateway.example.yaml`):
  the declarations of those that both have (filters, rates, bandwidth), and the options of `Owner.new/2` that they
  become. All checks are here, so a client that is added at run time gets the same error messages as one in a file.
  """

  import Aerie.Base.Settings.Field, only: [field: 3, field: 4, section: 3]

  alias Aerie.Base.Settings.Field
  alias MavRouter.Endpoints.Owner
  alias MavRouter.Endpoints.Queue.TrafficClass

  @plain [
    :side,
    :group,
    :role,
    :sniffer,
    :served,
    :rate_limits,
    :bytes_per_s,
    :broadcasts,
    :coalesce,
    :id_offsets,
    :sign,
    :gcs,
    :parts
  ]

  @doc "Their declarations."
  @spec fields() :: [Field.t()]
  def fields do
    [
      section(:filter_in, "What may come from it: by message name, system, component.", filter_fields()),
      section(
        :filter_out,
        "What may go to it; sources are the links and clients that it comes from.",
        filter_fields() ++ sources()
      ),
      field(
        :rate_limits,
        {:map, {:number, 0, 10_000}},
        "Messages by name, and how often a second each goes to it.",
        default: %{}
      ),
      field(
        :bytes_per_s,
        {:integer, 50, 1_000_000_000},
        """
        Bytes a second that may go to each of its peers; what is important goes first. A serial line's own if left out.
        """
      )
    ]
  end

  defp filter_fields do
    for {name, type} <- [
          messages: :string,
          systems: {:integer, 0, 4_294_967_295},
          components: {:integer, 0, 255}
        ],
        kind <- ["allow", "block"],
        do: field(:"#{kind}_#{name}", {:one_or_list, type}, "", default: [], filled: kind == "allow")
  end

  defp sources,
    do: [
      field(:allow_sources, {:one_or_list, :string}, "", default: [], filled: true),
      field(:block_sources, {:one_or_list, :string}, "", default: [])
    ]

  @doc "The options of `Owner.new/2` that a map of configuration keys has; keys that are left out or nil have none."
  @spec owner_options(map) :: {:ok, keyword} | {:error, String.t()}
  def owner_options(map) do
    with {:ok, carry} <- carry(map[:carry]) do
      more = [
        networks: map[:networks],
        carry: carry,
        in: filter(map[:filter_in]),
        out: filter(map[:filter_out]),
        queue: queue(map)
      ]

      plain = for key <- @plain, do: {key, map[key]}
      {:ok, Enum.reject(plain ++ more, fn {_key, value} -> value in [nil, [], %{}] end)}
    end
  end

  @doc "The keys that can be changed while a link or client runs (`MavRouter.Router.configure/3`)."
  @spec changeable() :: [atom]
  def changeable,
    do:
      (@plain -- [:side]) ++
        [:networks, :carry, :filter_in, :filter_out, :queue_frames, :queue_kb, :transfer_kb]

  @doc "Whether a value means that there is no such rule."
  @spec empty?(term) :: boolean
  def empty?(value), do: value in [nil, [], %{}]

  @doc "The value of a configuration key that options have, in the form of the configuration; nil for none."
  @spec key(atom, keyword) :: term
  def key(:queue_frames, options), do: options[:queue][:max_frames]

  def key(:queue_kb, options),
    do: with(bytes when bytes != nil <- options[:queue][:max_bytes], do: div(bytes, 1024))

  def key(:transfer_kb, options),
    do: with(bytes when bytes != nil <- options[:queue][:max_asked], do: div(bytes, 1024))

  def key(:carry, options) do
    with %{} = carry <- options[:carry],
         do: Map.new(carry, fn {class, link} -> {to_string(class), to_string(link)} end)
  end

  def key(key, options), do: options[option(key)]

  @doc "The option of `Owner.new/2` that a configuration key sets."
  @spec option(atom) :: atom
  def option(:filter_in), do: :in
  def option(:filter_out), do: :out
  def option(key) when key in [:queue_frames, :queue_kb, :transfer_kb], do: :queue
  def option(key), do: key

  defp filter(nil), do: nil
  defp filter(lists), do: lists |> Enum.reject(fn {_key, list} -> list in [nil, []] end) |> Map.new()

  defp queue(map) do
    frames = if map[:queue_frames], do: [max_frames: map[:queue_frames]], else: []
    bytes = if map[:queue_kb], do: [max_bytes: map[:queue_kb] * 1024], else: []
    asked = if map[:transfer_kb], do: [max_asked: map[:transfer_kb] * 1024], else: []
    asked ++ bytes ++ frames
  end

  defp carry(empty) when empty in [nil, %{}], do: {:ok, nil}

  defp carry(map) do
    Enum.reduce_while(map, {:ok, %{}}, fn {name, link}, {:ok, carry} ->
      case TrafficClass.parse(to_string(name)) do
        nil ->
          {:halt,
           {:error, "carry: #{inspect(name)} is not one of #{Enum.join(TrafficClass.classes(), ", ")}"}}

        class ->
          {:cont, {:ok, Map.put(carry, class, if(link in ["all", :all], do: :all, else: link))}}
      end
    end)
  end

  @doc "The error in the rules of a link or client, as a text; nil when there is none."
  @spec wrong(map) :: String.t() | nil
  def wrong(map) do
    with {:ok, options} <- owner_options(map), {:ok, _owner} <- Owner.new("any", options) do
      nil
    else
      {:error, words} -> words
    end
  end
end
