defmodule Aerie.Base.Files.Damaged do
  @moduledoc """
  Files of the gateway that cannot be read any more: each is set aside under another name, for somebody to examine, and named in the
  log and by the diagnosis. What kept its state in it starts without.
  """

  require Logger

  alias Aerie.Base.{Names, Store}

  @typedoc "The file, the name that it has now, and what it means, for people."
  @type t :: %{path: Path.t(), kept: Path.t(), words: String.t()}

  @doc "Renames a file. `words` say what is lost and what follows from it."
  @spec set_aside(Names.gateway(), Path.t(), String.t()) :: {:ok, Path.t()} | {:error, File.posix()}
  def set_aside(gateway, path, words) do
    kept = free("#{path}.damaged-#{stamp()}", 0)

    with :ok <- File.rename(path, kept) do
      note(gateway, path, kept, words)
      {:ok, kept}
    end
  end

  @doc """
  Whether a file that was refused is damaged. One that others can read is not: its owner has to decide what that means.
  """
  @spec damaged?(Path.t()) :: boolean()
  def damaged?(path) do
    case File.stat(path) do
      {:ok, %File.Stat{type: :regular, mode: mode}} -> Bitwise.band(mode, 0o077) == 0
      {:ok, %File.Stat{type: :directory}} -> true
      _other -> false
    end
  end

  @doc "Names damage that is kept under another name already, or where it is."
  @spec note(Names.gateway(), Path.t(), kept :: Path.t(), String.t()) :: :ok
  def note(gateway, path, kept, words) do
    Logger.error("#{path} is damaged#{if kept != path, do: " and was kept as #{kept}"}: #{words}")
    Store.remember(gateway, {__MODULE__, path}, %{path: path, kept: kept, words: words})
  rescue
    # The store is restarting, or there is none: the log has it.
    ArgumentError -> :ok
  end

  @doc "The files set aside since the gateway started."
  @spec list(Names.gateway()) :: [t()]
  def list(gateway), do: for({{__MODULE__, _path}, damaged} <- Store.remembered(gateway), do: damaged)

  defp free(path, n) do
    name = if n == 0, do: path, else: "#{path}-#{n}"
    if n < 1_000 and File.exists?(name), do: free(path, n + 1), else: name
  end

  defp stamp, do: Calendar.strftime(DateTime.utc_now(), "%Y%m%dT%H%M%SZ")
end
