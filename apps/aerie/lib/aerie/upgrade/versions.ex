defmodule Aerie.Upgrade.Versions do
  @moduledoc """
  The versions that are installed on this machine. Each has a folder of its own, named by version and content, which nothing changes: a
  gateway that runs from it finds its files until it ends.

      /opt/aerie                         link to the version in force
      /opt/aerie-versions/0.1.0-3f2a…    a version
      /opt/aerie-versions/former         link to the one before
      /opt/aerie-versions/next           link to one that was installed and is not in force yet
  """

  @enforce_keys [:folder, :own]
  defstruct [:folder, :own, :current, :former, :next]

  @typedoc "`own`: of the program that asks. `current`, `former` and `next` are whole paths, nil for none."
  @type t :: %__MODULE__{
          folder: Path.t(),
          own: Path.t(),
          current: Path.t() | nil,
          former: Path.t() | nil,
          next: Path.t() | nil
        }

  @doc "Those around a release's folder; an error for a release that is not installed."
  @spec find(root :: Path.t()) :: {:ok, t()} | {:error, String.t()}
  def find(root) do
    folder = Path.dirname(root)

    if Path.basename(folder) == "aerie-versions" do
      [current, former, next] =
        Enum.map([link(folder), Path.join(folder, "former"), Path.join(folder, "next")], &target/1)

      {:ok, %__MODULE__{folder: folder, own: root, current: current, former: former, next: next}}
    else
      {:error,
       "#{root} is not installed: only an installed gateway can be replaced while it runs (install.sh or the package, docs/operating.md)"}
    end
  end

  @doc "The same, where the gateway that runs is of the version in `root`: that one is in force, whatever the links say."
  @spec running(t(), root :: Path.t()) :: t()
  def running(versions, root),
    do: if(Path.dirname(root) == versions.folder, do: %{versions | current: root}, else: versions)

  @doc "Puts the own version in force; the one that was is the former one then."
  @spec put_in_force(t()) :: :ok | {:error, String.t()}
  def put_in_force(%{folder: folder, own: own, current: current} = versions) do
    with :ok <- point(link(folder), own),
         :ok <- if(current in [nil, own], do: :ok, else: point(Path.join(folder, "former"), current)),
         do: if(versions.next == own, do: again(Path.join(folder, "next"), nil), else: :ok)
  end

  @doc "As it was before `put_in_force/1`."
  @spec undo(t()) :: :ok | {:error, String.t()}
  def undo(%{current: nil}), do: :ok

  def undo(%{folder: folder} = versions) do
    with :ok <- point(link(folder), versions.current),
         :ok <- again(Path.join(folder, "former"), versions.former),
         do: again(Path.join(folder, "next"), versions.next)
  end

  defp again(link, nil), do: with({:error, :enoent} <- File.rm(link), do: :ok)
  defp again(link, target), do: point(link, target)

  @doc "Removes the versions that no link leads to."
  @spec remove_others(t()) :: :ok
  def remove_others(%{folder: folder, own: own}) do
    {:ok, versions} = find(own)
    kept = [own, versions.current, versions.former, versions.next]

    for name <- File.ls!(folder),
        path = Path.join(folder, name),
        path not in kept,
        name not in ~w(former next) do
      _ = File.rm_rf(path)
    end

    :ok
  end

  defp link(folder), do: folder |> Path.dirname() |> Path.join("aerie")

  defp target(link) do
    with {:ok, target} <- File.read_link(link),
         path = Path.expand(target, Path.dirname(link)),
         true <- File.dir?(path),
         do: path,
         else: (_none -> nil)
  end

  # Readers find the old or the new one.
  defp point(link, target) do
    new = link <> ".new"
    _ = File.rm(new)

    with :ok <- File.ln_s(Path.relative_to(target, Path.dirname(link)), new), :ok <- File.rename(new, link) do
      :ok
    else
      {:error, posix} -> {:error, "#{link}: #{:file.format_error(posix)}"}
    end
  end
end
