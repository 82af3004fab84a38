defmodule MavCodec.Definition.Importer do
  @moduledoc """
  Turns XML files into facts files: reads a file with its includes, checks everything, and returns what to write.
  After an error nothing is written.
  """

  alias MavCodec.Definition.{Document, Error, Facts, Parser, Resolver}

  @max_files 200

  @doc """
  Imports `paths` and their includes.

  Returns the facts files as `{name, iodata}`, sorted by name: the same input always gives the same bytes.
  """
  @spec import([Path.t()], Path.t() | nil) :: {:ok, [{String.t(), iodata()}]} | {:error, Error.t()}
  def import(paths, base \\ nil) do
    with {:ok, documents, _paths} <- load(paths, base),
         :ok <- check(Enum.map(paths, &document_name/1), documents) do
      {:ok, for({name, document} <- Enum.sort(documents), do: {facts_name(name), Facts.write(document)})}
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
    read = paths |> Enum.map(&Path.expand/1) |> Enum.reduce(%{}, &load(&1, &2, base))

    {:ok, Map.new(read, fn {name, {_path, document}} -> {name, document} end),
     read |> Enum.map(fn {_name, {path, _document}} -> path end) |> Enum.sort()}
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
      %{^name => {^path, _document}} ->
        read

      %{^name => {other, _document}} ->
        fail(path, nil, "another file of this name is needed too: #{other}")

      _new when map_size(read) >= @max_files ->
        fail(path, nil, "more than #{@max_files} files")

      _new ->
        document = document(path)
        Enum.reduce(document.includes, Map.put(read, name, {path, document}), &include(&1, path, &2, base))
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

  defp document(path) do
    with {:ok, bytes} <- File.read(path),
         {:ok, document} <- parse(path, bytes) do
      document
    else
      {:error, %Error{} = error} -> throw({:import, error})
      {:error, reason} -> fail(path, nil, "cannot be read: #{:file.format_error(reason)}")
    end
  end

  defp parse(path, bytes) do
    case Path.extname(path) do
      ".facts" -> Facts.read(bytes, path)
      _xml -> Parser.parse(bytes, document_name(path))
    end
  end

  @spec fail(Path.t(), pos_integer() | nil, String.t()) :: no_return()
  defp fail(path, line, reason),
    do: throw({:import, %Error{file: Path.basename(path), line: line, reason: reason}})
end
