defmodule Aerie.CLI.PolicyTrial.Recordings do
  @moduledoc "The recordings of a folder, so that those of one flight follow each other."

  @kinds ~w(.tlog .tlog.gz)
  @stamp ~r/\A(.*?)-?(\d{8}T\d{6}Z)(?:-(\d{1,3}))?\z/

  @type recording :: %{path: Path.t(), name: String.t(), label: String.t()}

  @doc "Those of a folder, or the one that a path names."
  @spec list(Path.t()) :: {:ok, [recording(), ...]} | {:error, String.t()}
  def list(path) do
    with {:ok, %{type: :directory}} <- File.stat(path), {:ok, names} <- File.ls(path) do
      case for(name <- names, String.ends_with?(name, @kinds), do: name) do
        [] -> {:error, "#{path}: there are no recordings in it (#{Enum.join(@kinds, ", ")})"}
        names -> {:ok, names |> Enum.sort_by(&order/1) |> Enum.map(&recording(Path.join(path, &1)))}
      end
    else
      {:ok, _file} -> {:ok, [recording(path)]}
      {:error, reason} -> {:error, "#{path}: #{:file.format_error(reason)}"}
    end
  end

  @doc "Whether it can be read to an end: a pipe may have none."
  @spec check(recording()) :: :ok | {:error, String.t()}
  def check(%{path: path}) do
    case File.stat(path) do
      {:ok, %{type: :regular}} -> :ok
      {:ok, _other} -> {:error, "#{path}: not a file"}
      {:error, reason} -> {:error, "#{path}: #{:file.format_error(reason)}"}
    end
  end

  defp recording(path) do
    {label, _start, _number} = order(Path.basename(path))
    %{path: path, name: Path.basename(path), label: label}
  end

  # As the recorder names them: what was recorded, when it began, and a number.
  defp order(name) do
    plain = name |> String.trim_trailing(".gz") |> String.trim_trailing(".tlog")

    case Regex.run(@stamp, plain) do
      [_all, label, start] -> {label, start, 1}
      [_all, label, start, number] -> {label, start, String.to_integer(number)}
      nil -> {plain, "", 1}
    end
  end
end
