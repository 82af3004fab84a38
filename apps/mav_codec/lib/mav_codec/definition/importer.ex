defmodule MavCodec.Definition.Importer do
  @moduledoc """
  Turns XML files into facts files: reads a file with its includes, checks everything, and returns what to write.
  After an error nothing is written.
  """

  alias MavCodec.Definition.{Document, Error, Facts, Resolver}
  alias MavCodec.Definition.Importer.Parser

  @max_files 200

  @doc """
  Imports `paths` and their includes.

  Returns the facts files as `{name, iodata}`, sorted by name: the same input always gives the same bytes.
  """
  @spec import([Path.t()], Path.t() | nil) :: {:ok, [{String.t(), iodata()}]} | {:error, Error.t()}
  def import(paths, base \\ nil) do
    with {:ok, read} <- read(paths, base),
         documents = Map.new(read, fn {name, {_path, _facts, document}} -> {name, document} end),
         :ok <- check(Enum.map(paths, &document_name/1), documents) do
      {:ok,
       for({name, {_path, facts, _document}} <- Enum.sort(read), do: {facts_name(name), Facts.text(facts)})}
    end
  end

  @doc """
  Reads `paths` (XML, or facts files) and their includes: the documents by file name and the paths that were read.

  An included file is searched beside the including one, then in `base`, a folder of facts files, for example of an
  imported source.
  """
  @spec load([Path.t()], Path.t() | nil) ::
          {:ok, %{String.t() => Document.t()}, [Path.t()]} | {:error, Error.t()}
  def load(paths, base) do
    with {:ok, read} <- read(paths, base) do
      {:ok, Map.new(read, fn {name, {_path, _facts, document}} -> {name, document} end),
       read |> Enum.map(fn {_name, {path, _facts, _document}} -> path end) |> Enum.sort()}
    end
  end

  # What was read, by file name: the path, its facts and its document.
  defp read(paths, base) do
    {:ok, paths |> Enum.map(&Path.expand/1) |> Enum.reduce(%{}, &load(&1, &2, base))}
  catch
    {:import, error} -> {:error, error}
  end

  # The name of the facts file of a definition file.
  defp facts_name(file), do: Path.basename(file, ".xml") <> ".facts"

  @doc "The name of the definition file that a path, of XML or of facts, is for."
  @spec document_name(Path.t()) :: String.t()
  def document_name(path), do: path |> Path.basename(".facts") |> Path.basename(".xml") |> Kernel.<>(".xml")

  defp check(roots, documents) do
    Enum.find_value(roots, :ok, fn root ->
      case Resolver.resolve(documents, root) do
        {:ok, _dialect} -> nil
        {:error, error} -> {:error, error}
      end
    end)
  end

  defp load(path, read, base) do
    name = document_name(path)

    case read do
      %{^name => {^path, _facts, _document}} ->
        read

      %{^name => {other, _facts, _document}} ->
        fail(path, nil, "another file of this name is needed too: #{other}")

      _new when map_size(read) >= @max_files ->
        fail(path, nil, "more than #{@max_files} files")

      _new ->
        {facts, document} = facts_of(path)
        read = Map.put(read, name, {path, facts, document})
        Enum.reduce(document.includes, read, &include(&1, path, &2, base))
    end
  end

  defp include({include, line}, path, read, base) do
    facts = facts_name(Resolver.include_name(include))

    candidates = [
      Path.expand(include, Path.dirname(path)),
      Path.expand(facts, Path.dirname(path)) | if(base, do: [Path.expand(facts, base)], else: [])
    ]

    case Enum.find(candidates, &File.regular?/1) do
      nil -> fail(path, line, "included file #{include} is missing")
      found -> load(found, read, base)
    end
  end

  defp facts_of(path) do
    facts? = Path.extname(path) == ".facts"
    name = if facts?, do: path, else: document_name(path)

    with {:ok, bytes} <- File.read(path),
         {:ok, facts} <- if(facts?, do: {:ok, Facts.facts(bytes)}, else: Parser.facts(bytes, name)),
         {:ok, document} <- Facts.document(facts, name) do
      {facts, document}
    else
      {:error, %Error{} = error} -> throw({:import, error})
      {:error, reason} -> fail(path, nil, "cannot be read: #{:file.format_error(reason)}")
    end
  end

  @spec fail(Path.t(), pos_integer() | nil, String.t()) :: no_return()
  defp fail(path, line, reason),
    do: throw({:import, %Error{file: Path.basename(path), line: line, reason: reason}})
end
