defmodule Aerie.Fleet.Bridge.Commands.Transfers do
  @moduledoc """
  Requests on `fleet.{environment}.{vehicle}.{area}.{operation}` other than commands: parameters, plans, files and logs. `docs/transfers.md` describes
  them.

  | area | operations |
  |---|---|
  | `params` | `list`, `get`, `set`, `load`, `metadata`; the first three of the autopilot unless `component` is given |
  | `mission` | `get`, `put`, `clear`; `kind` is `mission` unless given |
  | `files` | `list`, `read`, `write`, `remove`, `crc` |
  | `logs` | `list`, `read` |

  A log is read in pieces, each with a request of its own: nobody gets more at once than asked for, and what was interrupted goes on with
  the next request.
  """

  alias Aerie.Vehicle.Command.{Error, Result}
  alias Aerie.Base.{Json, Names}
  alias Aerie.Control.{Files, Logs, Missions, Params}
  alias Aerie.Vehicle.Command
  alias Aerie.Control.Params.{Param, Table}
  alias Aerie.Control.Policy.Roles

  # A message of NATS is a mebibyte at most by default.
  @max_bytes 1_000_000
  @areas %{
    "params" => ~w(list get set load metadata),
    "mission" => ~w(get put clear),
    "files" => ~w(list read write remove crc),
    "logs" => ~w(list read)
  }
  # In base64 it is a third larger.
  @max_piece div(@max_bytes * 7, 10)
  @piece 262_144
  @kinds %{"mission" => :mission, "fence" => :fence, "rally" => :rally}
  @common ~w(id vehicle type timeout source)
  @max_timeout_s Aerie.Control.Transfers.max_timeout_s()
  @changes [{"params", "set"}, {"params", "load"}, {"mission", "put"}, {"mission", "clear"}] ++
             [{"files", "write"}, {"files", "remove"}]

  @doc "The areas: what is subscribed to beside commands."
  @spec areas() :: [String.t()]
  def areas, do: Map.keys(@areas)

  @doc "The largest body and the largest reply in bytes."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc "All areas with their operations."
  @spec all() :: [{area :: String.t(), operation :: String.t()}]
  def all, do: for({area, operations} <- @areas, operation <- operations, do: {area, operation})

  @doc "Whether an operation changes something: it is a command, and needs an id."
  @spec changes?({area :: String.t(), operation :: String.t()}) :: boolean()
  def changes?(what), do: what in @changes

  @doc "The most bytes of one piece of a log."
  @spec max_piece() :: pos_integer()
  def max_piece, do: @max_piece

  @doc "An area and an operation that exist, as one name."
  @spec known?(area :: String.t(), operation :: String.t()) :: boolean()
  def known?(area, operation), do: operation in Map.get(@areas, area, [])

  @doc "The reply to a request of somebody; progress goes to `progress`."
  @spec answer(Names.gateway(), {String.t(), String.t()}, map(), Roles.source(), {pid(), term()}) :: map()
  def answer(gateway, {area, operation} = what, request, source, progress) do
    says = if is_binary(request["source"]) and byte_size(request["source"]) <= 256, do: request["source"]
    options = [as: source, via: "nats", progress: progress, says: says]

    with :ok <- exists(area, operation),
         {:ok, options} <- timeout(request["timeout"], options),
         {:ok, options} <- id(request["id"], what in @changes, options) do
      what |> run({gateway, request["vehicle"]}, request, options) |> plain(request["id"])
    else
      {:error, reason} -> plain({:error, reason}, request["id"])
    end
    |> bounded(request["id"])
  end

  defp exists(area, operation) do
    if known?(area, operation),
      do: :ok,
      else: wrong("subject", "#{area}. and one of #{Enum.join(@areas[area], ", ")}", operation)
  end

  defp timeout(nil, options), do: {:ok, options}

  defp timeout(seconds, options) when is_number(seconds) and seconds > 0 and seconds <= @max_timeout_s,
    do: {:ok, [timeout_ms: ceil(seconds * 1000)] ++ options}

  defp timeout(other, _options), do: wrong("timeout", "up to #{@max_timeout_s} seconds", other)

  # Without an id of the sender a copy of what changes the vehicle would be something new.
  defp id(nil, true, _options), do: wrong("id", "1 to 64 letters, digits, - and _", :missing)
  defp id(nil, false, options), do: {:ok, options}

  # It becomes part of a subject.
  defp id(id, _changes?, options) do
    if is_binary(id) and Command.token?(id),
      do: {:ok, [id: id] ++ options},
      else: wrong("id", "1 to 64 letters, digits, - and _", id)
  end

  # --- Operations

  defp run({"params", "list"}, {gateway, vehicle}, request, options) do
    with :ok <- known(request, ["component"]),
         {:ok, table} <- Params.list(gateway, vehicle, of(request, options)),
         do: {:ok, Table.plain(table)}
  end

  defp run({"params", "get"}, {gateway, vehicle}, request, options) do
    with :ok <- known(request, ["name", "component"]),
         {:ok, param} <- Params.get(gateway, vehicle, request["name"], of(request, options)),
         do: {:ok, Param.plain(param)}
  end

  # All of them may be more than a reply carries.
  defp run({"params", "metadata"}, {gateway, vehicle}, request, options) do
    with :ok <- known(request, ["names"]),
         {:ok, names} <- names(request["names"]),
         {:ok, all} <- Params.metadata(gateway, vehicle, options),
         do: {:ok, %{params: for(name <- names || Enum.sort(Map.keys(all)), one = all[name], do: one)}}
  end

  defp run({"params", "set"}, {gateway, vehicle}, request, options) do
    with :ok <- known(request, ["name", "value", "component"]),
         do: Params.set(gateway, vehicle, request["name"], request["value"], of(request, options))
  end

  defp run({"params", "load"}, {gateway, vehicle}, request, options) do
    with :ok <- known(request, ["file", "values"]) do
      case request do
        %{"file" => text} when is_binary(text) ->
          Params.load(gateway, vehicle, text, options)

        %{"values" => %{} = values} ->
          Params.set_all(gateway, vehicle, values, options)

        _neither ->
          wrong("values", "an object of names and numbers, or file, the text of a parameter file", :missing)
      end
    end
  end

  defp run({"mission", "get"}, {gateway, vehicle}, request, options) do
    with :ok <- known(request, ["kind"]),
         {:ok, kind} <- kind(request),
         {:ok, stored} <- Missions.download(gateway, vehicle, kind, options),
         do: {:ok, Missions.plain(stored, kind)}
  end

  defp run({"mission", "put"}, {gateway, vehicle}, request, options) do
    with :ok <- known(request, ["kind", "plan", "force"]),
         {:ok, force} <- force(request["force"]),
         {:ok, kind} <- kind(request) do
      case Missions.import(JSON.encode!(request["plan"]), :plan) do
        {:ok, plan} -> Missions.upload(gateway, vehicle, kind, plan, [force: force] ++ options)
        {:error, text} -> {:error, [Error.new("plan", text, :rule)]}
      end
    end
  end

  defp run({"mission", "clear"}, {gateway, vehicle}, request, options) do
    with :ok <- known(request, ["kind"]),
         {:ok, kind} <- kind(request),
         do: Missions.clear(gateway, vehicle, kind, options)
  end

  defp run({"files", operation}, place, request, options) do
    keys = if operation == "write", do: ["path", "data"], else: ["path"]

    with :ok <- known(request, keys),
         {:ok, path} <- path(request),
         do: file(operation, place, path, request, options)
  end

  defp run({"logs", "list"}, {gateway, vehicle}, request, options) do
    with :ok <- known(request, []),
         {:ok, logs} <- Logs.list(gateway, vehicle, options),
         do: {:ok, %{logs: logs}}
  end

  defp run({"logs", "read"}, {gateway, vehicle}, request, options) do
    with :ok <- known(request, ["log", "offset", "bytes"]),
         {:ok, entry} <- log(request["log"]),
         {:ok, offset} <- number(request, "offset", 0, 0..0xFFFF_FFFF),
         {:ok, bytes} <- number(request, "bytes", @piece, 1..@max_piece),
         {:ok, %{size: size}} <- Logs.same(gateway, vehicle, entry, options),
         from = min(offset, size),
         piece = %{entry | size: min(from + bytes, size)},
         {{:ok, _to}, data} <- Logs.fold(gateway, vehicle, piece, from, [], &[&2 | &1], options) do
      data = IO.iodata_to_binary(data)
      next = from + byte_size(data)
      # Nothing more is there, or the log is smaller than the list says.
      ends? = next >= size or next < piece.size

      {:ok, %{size: size, offset: from, next: if(not ends?, do: next), data: Base.encode64(data)}}
    else
      {{:error, result}, _data} -> {:error, result}
      error -> error
    end
  end

  defp file("list", {gateway, vehicle}, path, _request, options) do
    with {:ok, entries} <- Files.list(gateway, vehicle, path, options),
         do: {:ok, %{path: path, entries: entries}}
  end

  defp file("crc", {gateway, vehicle}, path, _request, options) do
    with {:ok, crc} <- Files.crc(gateway, vehicle, path, options), do: {:ok, %{path: path, crc32: crc}}
  end

  defp file("read", {gateway, vehicle}, path, _request, options) do
    with {:ok, bytes} <- Files.read(gateway, vehicle, path, [max_bytes: @max_piece] ++ options),
         do: {:ok, %{path: path, data: Base.encode64(bytes)}}
  end

  defp file("write", {gateway, vehicle}, path, request, options) do
    with data when is_binary(data) <- request["data"],
         {:ok, bytes} <- Base.decode64(data) do
      Files.write(gateway, vehicle, path, bytes, options)
    else
      _other -> wrong("data", "bytes in base64", :missing)
    end
  end

  defp file("remove", {gateway, vehicle}, path, _request, options),
    do: Files.remove(gateway, vehicle, path, options)

  # `Aerie.Control.Params` says what a component can be.
  defp of(request, options), do: [component: request["component"]] ++ options

  defp kind(request) do
    with :error <- Map.fetch(@kinds, request["kind"] || "mission"),
         do: wrong("kind", "mission, fence or rally", request["kind"])
  end

  defp force(nil), do: {:ok, false}
  defp force(force) when is_boolean(force), do: {:ok, force}
  defp force(other), do: wrong("force", "true or false", other)

  defp names(nil), do: {:ok, nil}

  defp names(names) do
    if is_list(names) and Enum.all?(names, &is_binary/1),
      do: {:ok, names},
      else: wrong("names", "a list of parameters' names", names)
  end

  # As `logs.list` shows it, so that nobody goes on with another log of the same id.
  defp log(%{"id" => id, "size" => size, "time" => time})
       when id in 0..0xFFFF and is_integer(size) and size >= 0 and (time == nil or is_integer(time)),
       do: {:ok, %{id: id, size: size, time: time}}

  defp log(other), do: wrong("log", "an entry of logs.list: id, size and time", other || :missing)

  defp number(request, key, default, first..last//_step) do
    case Map.get(request, key, default) do
      n when is_integer(n) and n in first..last//1 -> {:ok, n}
      other -> wrong(key, "an integer from #{first} to #{last}", other)
    end
  end

  defp path(%{"path" => path}) when is_binary(path), do: {:ok, path}
  defp path(request), do: wrong("path", "a text", Map.get(request, "path", :missing))

  defp known(request, keys) do
    case Map.keys(request) -- (@common ++ keys) do
      [] -> :ok
      [key | _rest] -> wrong(Error.key(key), "only #{Enum.join(["id", "timeout" | keys], ", ")}", :unknown)
    end
  end

  defp wrong(key, expected, got), do: {:error, [Error.new(key, expected, got)]}

  # --- Replies

  defp plain({:ok, %Result{} = result}, _id), do: Result.plain(result)
  # An unknown vehicle is reported before there is an id.
  defp plain({:error, %Result{} = result}, id), do: Result.plain(%{result | id: id || result.id})
  defp plain({:ok, value}, id), do: Map.merge(%{"id" => id, "result" => "completed", "reason" => nil}, value)
  defp plain({:pending, id}, _id), do: %{"id" => id, "result" => nil, "reason" => "it is under way"}

  defp plain({:error, errors}, id) do
    shown = for error <- errors, do: error |> Map.from_struct() |> Map.take([:key, :expected, :got])

    %{
      "id" => short(id),
      "result" => "rejected",
      "rule" => "malformed",
      "reason" => Error.text(errors),
      "errors" => shown
    }
  end

  defp short(id), do: if(is_binary(id) and byte_size(id) <= 64, do: id)

  defp bounded(reply, id) do
    body = Json.encode_to_iodata!(reply)

    if IO.iodata_length(body) <= @max_bytes do
      reply
    else
      reason =
        "the reply has #{IO.iodata_length(body)} bytes, more than the #{@max_bytes} that NATS carries; ask over REST"

      %{"id" => short(id), "result" => "failed", "rule" => "size", "reason" => reason}
    end
  end
end
