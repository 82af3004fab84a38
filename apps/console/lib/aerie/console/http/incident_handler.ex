defmodule Aerie.Console.HTTP.IncidentHandler do
  @moduledoc """
  Packs what is known of a vehicle in a span of time into one archive, and serves it to admins:
  `/download/incident?vehicle=VID-001&from=…&to=…`, in unix seconds. One at a time; what is being done is a notice
  `:incident`. The last archive stays in the console's folder until the next one is packed, for its owner only.
  """

  @behaviour :cowboy_handler

  alias Aerie.Base.Files.Private
  alias Aerie.Base.{Names, PubSub}
  alias Aerie.Console.HTTP.DownloadHandler
  alias Aerie.Vehicle.Command

  @most_s 7_200
  # Cowboy closes a connection on which nothing comes for a minute.
  @patience_ms 1_800_000
  @elsewhere "zoom in (+), or use aerie incident on the gateway's machine, which packs up to seven days"

  @typedoc "Packs a vehicle's span (unix microseconds) into a folder; `note` gets lines about what is being done."
  @type pack :: (vehicle :: String.t(),
                 {from :: integer(), to :: integer()},
                 Path.t(),
                 note :: (String.t() -> term()) ->
                   {:ok, Path.t(), notes :: [String.t()]} | {:error, String.t()})

  @doc "The longest span, in seconds."
  @spec most_s() :: pos_integer()
  def most_s, do: @most_s

  @impl :cowboy_handler
  def init(request, state) do
    with {:ok, _admin} <- DownloadHandler.allowed(request, :admin, state),
         {:ok, vehicle, span} <- wanted(request),
         {:ok, path} <- packed(request, vehicle, span, state) do
      headers = DownloadHandler.headers("application/gzip", Path.basename(path))
      {:ok, :cowboy_req.reply(200, headers, {:sendfile, 0, File.stat!(path).size, path}, request), state}
    else
      {:refused, request} -> {:ok, request, state}
      {status, words} -> {:ok, DownloadHandler.text(request, status, words), state}
    end
  end

  defp wanted(request) do
    query = Map.new(:cowboy_req.parse_qs(request))

    with <<vehicle::binary>> <- query["vehicle"],
         true <- Command.token?(vehicle),
         {from, ""} when from >= 0 <- Integer.parse(query["from"] || ""),
         {to, ""} when to > from and to < 4_102_444_800 <- Integer.parse(query["to"] || "") do
      if to - from <= @most_s,
        do: {:ok, vehicle, {from * 1_000_000, min(to * 1_000_000, System.os_time(:microsecond))}},
        else: {413, "The time in view is longer than #{div(@most_s, 3_600)} hours: #{@elsewhere}."}
    else
      _other -> {400, "vehicle, from and to are needed: a vehicle's name, and two times in unix seconds."}
    end
  end

  defp packed(_request, _vehicle, _span, %{pack: nil}), do: {404, "This gateway packs no incidents."}

  defp packed(request, vehicle, span, %{gateway: gateway, pack: pack, dir: dir}) do
    folder = Path.join(dir, "incident")
    :ok = :cowboy_req.cast({:set_options, %{idle_timeout: @patience_ms}}, request)
    # Telemetry goes first.
    _normal = Process.flag(:priority, :low)

    with :ok <- Names.register(gateway, :incident, nil),
         {:ok, _files} <- File.rm_rf(folder),
         :ok <- Private.folder(folder),
         {:ok, path, _notes} <-
           pack.(vehicle, span, folder, &PubSub.publish(gateway, {:notice, :incident}, &1)) do
      {:ok, path}
    else
      {:error, :taken} -> {429, "Another archive is being packed; try again when it is done."}
      {:error, text} when is_binary(text) -> {422, text}
      {:error, reason} -> {503, "#{folder}: #{:file.format_error(reason)}"}
      {:error, reason, path} -> {503, "#{path}: #{:file.format_error(reason)}"}
    end
  end
end
