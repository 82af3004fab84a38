defmodule MavCodec.Definition.Importer do
  @moduledoc """
  XML files in, facts files out: reads a file and all that it includes, checks the whole, and says what to write.
  Nothing is written unless everything is right.
  """

  alias MavCodec.Definition.{Document, Error, Facts, Parser, Resolver}

  @max_files 200

  @doc """
  Imports `paths` and their includes.

  An included file is looked for beside the including one, then in `base` (a folder of facts files, such as those of
  another source that is already imported); what is found there is copied along, so that the result stands alone.

  Returns the facts files as `{name, iodata}`, sorted by name.
  """
  @spec import([Path.t()], Path.t() | nil) :: {:ok, [{String.t(), iodata()}]} | {:error, Error.t()}
  def import(paths, base \\ nil) do
    documents = Enum.reduce(paths, %{}, &load(&1, &2, base))
    roots = Enum.map(paths, &Path.basename/1)

    Enum.each(roots, fn root ->
      case Resolver.resolve(documents, root) do
        {:ok, _dialect} -> :ok
        {:error, error} -> throw({:import, error})
      end
    end)

    {:ok, for({name, document} <- Enum.sort(documents), do: {facts_name(name), Facts.write(document)})}
  catch
    {:import, error} -> {:error, error}
  end

  @doc "The name of the facts file of a definition file."
  @spec facts_name(String.t()) :: String.t()
  def facts_name(file), do: Path.basename(file, ".xml") <> ".facts"

  defp load(path, documents, base) do
    name = Path.basename(path)

    cond do
      is_map_key(documents, name) -> documents
      map_size(documents) >= @max_files -> throw({:import, error(path, nil, "more than #{@max_files} files")})
      true -> path |> read() |> includes(path, documents, base)
    end
  end

  defp includes(%Document{} = document, path, documents, base) do
    documents = Map.put(documents, document.file, document)

    Enum.reduce(document.includes, documents, fn {include, line}, documents ->
      beside = Path.join(Path.dirname(path), include)
      facts = base && Path.join(base, facts_name(include))

      cond do
        is_map_key(documents, Resolver.include_name(include)) -> documents
        File.regular?(beside) -> load(beside, documents, base)
        facts && File.regular?(facts) -> load(facts, documents, base)
        true -> throw({:import, error(path, line, "included file #{include} is missing")})
      end
    end)
  end

  defp read(path) do
    with {:ok, bytes} <- File.read(path),
         {:ok, document} <- parse(path, bytes) do
      document
    else
      {:error, %Error{} = error} -> throw({:import, error})
      {:error, reason} -> throw({:import, error(path, nil, "cannot be read: #{:file.format_error(reason)}")})
    end
  end

  defp parse(path, bytes) do
    case Path.extname(path) do
      ".facts" -> Facts.read(bytes, path)
      _xml -> Parser.parse(bytes, Path.basename(path))
    end
  end

  defp error(path, line, reason), do: %Error{file: Path.basename(path), line: line, reason: reason}
end
