defmodule Aerie.Fleet.Operations.Journal do
  @moduledoc """
  Operations on the disk, so that a gateway that starts again knows who had begun: a file of lines of JSON for each,
  for the owner only. The first line is the operation, each other one something that happened to it, written before it
  is done:

      {"id": "up-1", "object": {…}, "vehicles": ["sim-001", …], "source": "ann", "via": "console", "at": 18…}
      {"begun": ["sim-001"]}
      {"ended": "sim-001", "verdict": "ok", "status": "completed", "reason": null}
      {"state": "paused", "at": 1800000009000000}

  A line that was torn by a kill or a power cut did not happen. A file that cannot be read costs only its operation,
  and is set aside (`Aerie.Base.Files.Damaged`). The author is kept as a name only: what is continued
  is done in the name of the one who continues it.
  """

  alias Aerie.Base.Files.{Damaged, Private}
  alias Aerie.Base.Names
  alias Aerie.Control.Policy.Roles
  alias Aerie.Fleet.Operations.{Core, Request}
  alias Aerie.Fleet.Operations.Sequence.GivingWay

  # A request, and for each vehicle two lines with reasons.
  @max_bytes 4_000_000
  @max_files 256
  @states ~w(running paused stopped halted done interrupted)a
  @lost "what became of its vehicles is in the audit log"

  @doc "Begins the file of an operation, whose request was `object`."
  @spec begin(Path.t(), map()) :: :ok | {:error, File.posix()}
  def begin(dir, entry) do
    head = entry |> Map.take([:id, :object, :vehicles, :via, :at]) |> Map.put(:source, entry.source.name)

    # Not brought to the disk: what stops a vehicle waits for no slow card, and the ledger knows what was done.
    Private.write(path(dir, entry.id), [JSON.encode_to_iodata!(head), ?\n], false)
  end

  @doc "Writes what happened to an operation: the vehicles that begin, and how `core` differs from the one before."
  @spec note(Path.t(), String.t(), Core.t(), Core.t(), begun :: [String.t()], now :: integer()) ::
          :ok | {:error, File.posix()}
  def note(dir, id, before, core, begun, now) do
    ended =
      for {vehicle, result} <- Map.drop(core.results, Map.keys(before.results)),
          do: result |> Map.put(:ended, vehicle) |> Map.update!(:verdict, &Atom.to_string/1)

    begun = if begun == [], do: [], else: [%{begun: begun}]
    state = if core.state == before.state, do: [], else: [%{state: Atom.to_string(core.state), at: now}]

    lines = begun ++ ended ++ state

    # A file that was given up does not come back without its beginning.
    if lines != [] and File.exists?(path(dir, id)),
      do:
        File.write(path(dir, id), for(line <- lines, do: [JSON.encode_to_iodata!(line), ?\n]), [:append, :raw]),
      else: :ok
  end

  @doc "Forgets an operation."
  @spec forget(Path.t(), String.t()) :: :ok | {:error, File.posix()}
  def forget(dir, id), do: with({:error, :enoent} <- File.rm(path(dir, id)), do: :ok)

  # An id has letters, digits, - and _ only.
  defp path(dir, id), do: Path.join(dir, id <> ".jsonl")

  @doc "The operations of a folder, which is made if it is not there. Those that ran are interrupted."
  @spec load(Names.gateway(), Path.t()) :: {:ok, [map()]} | {:error, File.posix()}
  def load(gateway, dir) do
    with :ok <- Private.folder(dir), {:ok, names} <- File.ls(dir) do
      files = for name <- Enum.sort(names), Path.extname(name) == ".jsonl", do: Path.join(dir, name)
      {:ok, files |> Enum.take(@max_files) |> Enum.flat_map(&load_file(gateway, &1))}
    end
  end

  defp load_file(gateway, path) do
    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(path),
         {:ok, text} <- File.read(path),
         {:ok, head, lines, whole} <- lines(text),
         {:ok, entry} <- entry(head, lines),
         true <- Path.basename(path, ".jsonl") == entry.id,
         # What is written next must not stand behind half a line.
         :ok <- if(whole == text, do: :ok, else: Private.write(path, whole)) do
      [entry]
    else
      _damaged ->
        _ = Damaged.set_aside(gateway, path, @lost)
        []
    end
  end

  defp lines(text) do
    {whole, [_torn]} = text |> String.split("\n") |> Enum.split(-1)
    decoded = Enum.map(whole, &JSON.decode/1)

    case {Enum.all?(decoded, &match?({:ok, %{}}, &1)), decoded} do
      {true, [{:ok, head} | lines]} ->
        {:ok, head, Enum.map(lines, &elem(&1, 1)), Enum.map_join(whole, &(&1 <> "\n"))}

      _damaged ->
        :error
    end
  end

  defp entry(
         %{
           "id" => id,
           "object" => %{} = object,
           "vehicles" => [_ | _] = ids,
           "source" => name,
           "via" => via,
           "at" => at
         },
         lines
       )
       when is_binary(name) and is_binary(via) and is_integer(at) do
    with true <- Enum.all?(ids, &is_binary/1),
         {:ok, request} <- Request.parse(Map.put(object, "id", id), at),
         {core, _first_step} = Core.new(ids, request.plan),
         core = %{core | waiting: Enum.uniq(ids), under_way: MapSet.new(), steps: 0},
         {%Core{} = core, done_at} <- Enum.reduce_while(lines, {core, nil}, &happened/2) do
      {:ok,
       %{
         id: request.id,
         object: object,
         request: request,
         vehicles: Enum.uniq(ids),
         core: Core.interrupted(core),
         source: Roles.principal(:gateway, name, :viewer),
         via: via,
         at: at,
         done_at: done_at || at,
         doing: %{},
         way: GivingWay.new([request.id], GivingWay.ends?(request.what)),
         then: nil
       }}
    else
      _damaged -> :error
    end
  end

  defp entry(_head, _lines), do: :error

  defp happened(%{"begun" => [_ | _] = begun}, {core, at}) do
    core = %{
      core
      | waiting: core.waiting -- begun,
        under_way: MapSet.union(core.under_way, MapSet.new(begun)),
        steps: 1
    }

    {:cont, {core, at}}
  end

  defp happened(%{"ended" => vehicle, "verdict" => verdict, "status" => status} = line, {core, at}) do
    result = %{verdict: if(verdict == "ok", do: :ok, else: :failed), status: status, reason: line["reason"]}
    under_way = MapSet.delete(core.under_way, vehicle)
    {:cont, {%{core | under_way: under_way, results: Map.put(core.results, vehicle, result)}, at}}
  end

  defp happened(%{"state" => name, "at" => at}, {core, _at}) when is_integer(at) do
    case Enum.find(@states, &(Atom.to_string(&1) == name)) do
      nil -> {:halt, :error}
      state -> {:cont, {%{core | state: state}, at}}
    end
  end

  defp happened(_other, _so_far), do: {:halt, :error}
end
