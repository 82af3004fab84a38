defmodule Aerie.Control.Policy.StoreTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Store

  @moduletag :tmp_dir

  defp square(south),
    do: ~s({"type": "Polygon", "coordinates": [[[8, #{south}], [9, #{south}], [9, 48], [8, 48]]]})

  test "files that changed are in force when they are read again; those with errors are not, and that is shown",
       %{
         tmp_dir: dir
       } do
    gateway = make_ref()
    file = Path.join(dir, "fence.geojson")
    File.write!(file, square(47))
    section = %{geofence_file: file}
    {:ok, policy} = Policy.compile(section)
    start_supervised!({Store, gateway: gateway, policy: policy, read: fn -> {:ok, section} end})
    assert %{since: since, problem: nil} = Store.status(gateway)

    File.write!(file, square(46))
    assert :ok = Store.reload(gateway, "test")
    new = Store.get(gateway)
    assert new != policy
    assert %{since: later, problem: nil} = Store.status(gateway)
    assert later > since

    File.write!(file, "no fence")

    log =
      capture_log(fn -> assert {:error, ["policy.geofence_file: " <> _]} = Store.reload(gateway, "test") end)

    assert log =~ "policy: not loaded (test), that of"
    assert Store.get(gateway) == new
    assert %{since: ^later, problem: %{errors: ["policy.geofence_file: " <> _]}} = Store.status(gateway)

    File.write!(file, square(46))
    assert :ok = Store.reload(gateway, "test")
    assert %{problem: nil} = Store.status(gateway)
    stop_supervised!(Store)
    assert Store.get(gateway) == nil
    assert Store.status(gateway) == nil
    assert {:error, ["the gateway does not run"]} = Store.reload(gateway, "test")
  end
end
