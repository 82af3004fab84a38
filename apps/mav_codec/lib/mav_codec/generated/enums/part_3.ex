defmodule MavCodec.Generated.Enums.Part3 do
  use MavCodec.Definition.Shard, enums: {3, 4}
end
