defmodule MavRouter.Endpoints.Settings do
  @moduledoc """
  From the keys of the configuration (`links` and `clients`, see `config/gateway.example.yaml`) to the rules of an owner. All checks
  are here, so a client that is added at run time gets the same error messages as one in a file.
  """
  use Aerie.Base.Settings

  alias MavRouter.Endpoints.Queue.TrafficClass
  alias MavRouter.Endpoints.Owner

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

  part :identity, MavRouter.Identity.Settings

  section "router", "How frames go from one to the other."

  setting :between_vehicles,
          {:enum, [:auto, :all, :heartbeats, :none]},
          """
          Which broadcasts of other vehicles a vehicle gets: heartbeats, none; auto: heartbeats in networks of at most 32
          vehicles, else none; all: their telemetry as well, such as positions for following and avoidance. Commands,
          sticks and input of estimators never go from one vehicle to another.
          """,
          default: :auto

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
