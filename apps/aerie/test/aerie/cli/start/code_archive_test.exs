defmodule Aerie.CLI.Start.CodeArchiveTest do
  use ExUnit.Case, async: true

  import Aerie.OtherVM

  alias Aerie.CLI.Start.{CodeArchive, ModuleLoader}

  @moduletag :tmp_dir

  test "code comes from memory, whatever becomes of the files", %{tmp_dir: folder} do
    path = Path.join(folder, "code.zip")
    :ok = ModuleLoader.pack(path, Path.join(Mix.Project.build_path(), "consolidated"))
    # Its time changes as that of /dev/null may.
    name = Path.join(folder, "name")
    File.touch!(name)

    script = """
    :ok = Aerie.CLI.Start.CodeArchive.open(#{inspect(path)}, ~c"#{name}")
    File.rm!(#{inspect(path)})
    :code.set_path([~c"#{name}" | for(path <- :code.get_path(), to_string(path) =~ "elixir", do: path)])
    found = [Code.ensure_loaded(Aerie.Console.Pages.Audit.Page)]
    File.touch!(#{inspect(name)}, 0)
    found = [Code.ensure_loaded(Aerie.Console.Pages.Links.Page), Code.ensure_loaded(Aerie.NoSuchModule) | found]
    IO.puts("found " <> inspect(found))
    """

    {_port, found} = other_vm(script, "found ")

    assert found ==
             "[module: Aerie.Console.Pages.Links.Page, error: :nofile, module: Aerie.Console.Pages.Audit.Page]"
  end

  test "a damaged archive is not used, because it would hide the files", %{tmp_dir: folder} do
    path = Path.join(folder, "code.zip")
    {:ok, {_name, zip}} = :zip.create(~c"code", [{~c"a.beam", "code"}], [:memory])
    whole = <<:erlang.crc32(zip)::32, zip::binary>>

    for damaged <- [
          "",
          "abc",
          binary_part(whole, 0, byte_size(whole) - 1),
          String.replace(whole, "code", "coda")
        ] do
      File.write!(path, damaged)
      assert CodeArchive.open(path, String.to_charlist(path)) == :none
    end

    assert CodeArchive.open(Path.join(folder, "none")) == :none
  end

  test "what a flight uses is code of the gateway" do
    flight = ModuleLoader.flight()
    assert Aerie.Vehicle.Session in flight and MavCodec.Messages.Attitude in flight
    assert flight -- ModuleLoader.all() == []
  end
end
