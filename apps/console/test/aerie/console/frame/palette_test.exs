defmodule Aerie.Console.Frame.PaletteTest do
  use Aerie.ConsoleCase, async: true

  alias Aerie.Base.Names
  alias Aerie.Console.Frame.Palette
  alias Aerie.Control.Params.{Cache, Param, Table}

  @moduletag :tmp_dir
  @user %{name: "ann", role: :operator, permissions: []}

  test "parameters are found by the names that were read of the vehicle that is shown", %{tmp_dir: dir} do
    [console: console] = start_console()
    put_vehicle(console, "VID-007", [], %{key: {"main", 7}, system_id: 7})
    put_vehicle(console, "VID-008", [], %{key: {"main", 8}, system_id: 8})

    find = fn path, query ->
      for %{note: note} = item <- Palette.find(console.gateway, @user, path, query),
          note =~ "parameter",
          do: {item.label, item.to}
    end

    more = {"RTL", "/params?vehicle=VID-007&search=rtl"}
    assert find.("/vehicles/VID-007", "rtl") == [more]

    :ok = Names.register(console.gateway, :params_cache, nil)
    Names.put_value(console.gateway, :params_cache, dir)
    names = ~w(RTL_ALT RTL_SPEED WPNAV_SPEED) ++ for(n <- 1..20, do: "SERVO#{n}_MIN")
    table = Table.new(for(name <- names, do: %Param{name: name, value: 1, type: 4}), hash: 1)
    :ok = Cache.store(dir, {:system, "main", 7}, table, 10)

    assert find.("/vehicles/VID-007/charts", "rtl") == [
             {"RTL_ALT", "/params?vehicle=VID-007&search=RTL_ALT"},
             {"RTL_SPEED", "/params?vehicle=VID-007&search=RTL_SPEED"},
             more
           ]

    assert length(find.("/vehicles/VID-007", "servo")) == 9
    assert find.("/vehicles/VID-008", "rtl") == [{"RTL", "/params?vehicle=VID-008&search=rtl"}]
    assert find.("/", "rtl") == []
    assert find.("/vehicles/VID-007", "rt") == []
  end
end
