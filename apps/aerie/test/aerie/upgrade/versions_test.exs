defmodule Aerie.Upgrade.VersionsTest do
  use ExUnit.Case, async: true

  alias Aerie.Upgrade.Versions

  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    folder = Path.join(dir, "aerie-versions")
    for name <- ~w(1 2 3), do: File.mkdir_p!(Path.join(folder, name))
    File.ln_s!("aerie-versions/1", Path.join(dir, "aerie"))
    %{folder: folder, link: Path.join(dir, "aerie")}
  end

  defp find(folder, name) do
    assert {:ok, versions} = folder |> Path.join(name) |> Versions.find()
    for path <- [versions.current, versions.former, versions.next], do: path && Path.basename(path)
  end

  test "another version comes in force, the one that was is the former one, and that is undone", %{
    folder: folder
  } do
    File.ln_s!("2", Path.join(folder, "next"))
    assert find(folder, "2") == ["1", nil, "2"]
    {:ok, versions} = Versions.find(Path.join(folder, "2"))
    assert :ok = Versions.put_in_force(versions)
    assert find(folder, "2") == ["2", "1", nil]
    assert :ok = Versions.undo(versions)
    assert find(folder, "2") == ["1", nil, "2"]
  end

  test "what runs is the former one, whatever the link says", %{folder: folder} do
    {:ok, versions} = Versions.find(Path.join(folder, "2"))
    assert :ok = versions |> Versions.running(Path.join(folder, "3")) |> Versions.put_in_force()
    assert find(folder, "2") == ["2", "3", nil]
    # One of another place cannot be gone back to.
    assert Versions.running(versions, "/elsewhere/3") == versions
  end

  test "only versions that a link leads to stay", %{folder: folder} do
    {:ok, versions} = Versions.find(Path.join(folder, "2"))
    :ok = Versions.put_in_force(versions)
    assert :ok = Versions.remove_others(versions)
    assert folder |> File.ls!() |> Enum.sort() == ~w(1 2 former)
  end

  test "ignores a link to nothing and a release elsewhere; without the right to write nothing changes",
       %{
         folder: folder,
         link: link,
         tmp_dir: dir
       } do
    File.ln_s!("gone", Path.join(folder, "former"))
    assert find(folder, "2") == ["1", nil, nil]
    assert {:error, text} = Versions.find(dir)
    assert text =~ "is not installed"
    # A folder in its place.
    {:ok, versions} = Versions.find(Path.join(folder, "2"))
    File.rm!(link)
    File.mkdir!(link)
    assert {:error, text} = Versions.put_in_force(versions)
    assert text =~ link
  end
end
