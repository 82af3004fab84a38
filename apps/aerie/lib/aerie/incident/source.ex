defmodule Aerie.Incident.Source do
  @moduledoc """
  Where an incident is read from: a running gateway, or the folders of one that has stopped. The configuration says
  where the files of both are. What only a running gateway knows is asked from it in single calls; each answer may also
  be an error, which becomes a note.
  """

  alias Aerie.Base.{Json, Names, Store}
  alias Aerie.Config
  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Fleet.Diagnosis
  alias Aerie.Fleet.Shadow
  alias Aerie.Fleet.Shadow.Store.LocalStore
  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.Events.Journal
  alias MavRouter.Recorder

  @second 1_000_000

  @enforce_keys [:config, :base]
  defstruct [:config, :base, :call, gateway: :default]

  @typedoc """
  `base`: what relative paths of the configuration begin at; `call`: calls a function where the gateway runs, nil if it
  has stopped; `gateway`: its name there.
  """
  @type t :: %__MODULE__{config: Config.t(), base: Path.t(), call: call() | nil, gateway: Names.gateway()}
  @typedoc "Calls a function in a gateway; the error is a text."
  @type call :: (module(), function :: atom(), arguments :: [term()] -> term() | {:error, String.t()})

  @doc "A running gateway."
  @spec running(call(), Names.gateway()) :: {:ok, t()} | {:error, String.t()}
  def running(call, gateway \\ :default) do
    with %Config{} = config <- call.(Names, :value, [gateway, :reload]),
         base when is_binary(base) <- call.(File, :cwd!, []) do
      {:ok, %__MODULE__{config: config, base: base, call: call, gateway: gateway}}
    else
      {:error, text} -> {:error, text}
      _other -> {:error, "the gateway starts or stops just now; --config FILE reads the folders without it"}
    end
  end

  @doc "The same with the name that the gateway gave a vehicle, which the configuration may not have."
  @spec with_vehicle(t(), String.t()) :: t()
  def with_vehicle(%{call: nil} = source, _vehicle), do: source

  def with_vehicle(%{call: call, config: config} = source, vehicle) do
    case call.(Store, :vehicle, [source.gateway, vehicle]) do
      %{key: {network, system}} ->
        named = %{id: vehicle, network: network, system_id: system}

        others =
          Enum.reject(config.vehicles, &(&1.id == vehicle or {&1.network, &1.system_id} == {network, system}))

        %{source | config: %{config | vehicles: [named | others]}}

      _not_heard ->
        source
    end
  end

  @doc "The folders of a gateway that has stopped, by its configuration."
  @spec stopped(Config.t()) :: t()
  def stopped(config), do: %__MODULE__{config: config, base: File.cwd!()}

  @doc "A folder of the configuration."
  @spec folder(t(), Path.t()) :: Path.t()
  def folder(%__MODULE__{base: base}, dir), do: Path.expand(dir, base)

  @doc """
  Has the last minutes of a vehicle written to a file, unless it is being recorded. A note says why they could not be.
  """
  @spec save(t(), String.t(), Aerie.Incident.Span.t(), now :: integer()) :: [String.t()]
  def save(%{call: nil}, _vehicle, _span, _now), do: []

  def save(%{call: call, config: config} = source, vehicle, span, now) do
    ring_us = Recorder.Settings.from(config).ring_ms * 1000
    since = max(span.from, now - ring_us)

    # A recording that began later lacks what led up to it.
    recorded? =
      case call.(Recorder, :status, [source.gateway, {:vehicle, vehicle}]) do
        %{state: :recording, since: begun} when is_integer(begun) -> begun * @second <= since
        _other -> false
      end

    if recorded? or span.to < now - ring_us do
      []
    else
      case call.(Recorder, :save, [source.gateway, vehicle, "incident"]) do
        {:ok, _file} ->
          []

        {:error, error} ->
          ["the last minutes of #{vehicle}, which the gateway keeps in memory: #{reason(error)}"]
      end
    end
  end

  @doc "The gateway's own events of a vehicle, those of the last 256 that it still has, with their lines."
  @spec events(t(), String.t()) :: {[{Event.t(), String.t()}], notes :: [String.t()]}
  def events(%{call: nil}, _vehicle),
    do: {[], ["the gateway's own list of events: it is lost when a gateway stops"]}

  def events(%{call: call} = source, vehicle) do
    with events when is_list(events) <- call.(Journal, :recent, [source.gateway, vehicle]),
         epoch when is_integer(epoch) or is_nil(epoch) <- call.(Journal, :epoch, [source.gateway]) do
      {for(event <- events, do: {event, Json.line(Message.event(event, epoch))}), []}
    else
      {:error, error} -> {[], ["the gateway's own list of events: #{reason(error)}"]}
    end
  end

  @doc "Desired and reported state as they are now; of a stopped gateway the copy of the desired one."
  @spec shadow(t(), String.t()) :: {map() | nil, notes :: [String.t()]}
  def shadow(%{call: nil} = source, vehicle) do
    with text when is_binary(text) <- LocalStore.read(folder(source, source.config.shadow.dir), vehicle),
         {:ok, %{} = document} <- JSON.decode(text) do
      document = Map.delete(document, "seal")
      values = for {path, %{"value" => value}} <- document["fields"] || %{}, into: %{}, do: {path, value}
      {Map.put(document, "desired", values), ["the reported state: the gateway has stopped"]}
    else
      _none -> {nil, ["desired and reported state: the gateway has stopped, and has no copy of #{vehicle}"]}
    end
  end

  def shadow(%{call: call} = source, vehicle) do
    case call.(Shadow, :get, [source.gateway, vehicle]) do
      {:ok, shadow} -> {Json.plain(shadow), []}
      {:error, text} when is_binary(text) -> {nil, ["desired and reported state: #{text}"]}
      {:error, refusal} -> {nil, ["desired and reported state: #{Shadow.text(refusal)}"]}
    end
  end

  @doc "What the diagnosis finds now about the vehicle, the links and the gateway."
  @spec conditions(t(), String.t()) :: {[map()] | nil, notes :: [String.t()]}
  def conditions(%{call: nil}, _vehicle), do: {nil, ["the diagnosis: only a running gateway has one"]}

  def conditions(%{call: call} = source, vehicle) do
    case call.(Diagnosis, :list, [source.gateway]) do
      conditions when is_list(conditions) ->
        {for(c <- conditions, not other?(c.subject, vehicle), do: Diagnosis.Condition.plain(c)), []}

      {:error, error} ->
        {nil, ["the diagnosis: #{reason(error)}"]}
    end
  end

  defp other?({:vehicle, id}, vehicle), do: id != vehicle
  defp other?(subject, _vehicle), do: match?({:client, _id}, subject)

  defp reason(text) when is_binary(text), do: text
  defp reason(error), do: Exception.message(error)
end
