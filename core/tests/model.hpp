// Small MuJoCo models for the C++ tests, from text.
#pragma once

#include <mujoco/mujoco.h>

#include <memory>
#include <stdexcept>

namespace rcs::test {

struct DeleteModel {
  void operator()(mjModel* model) const { mj_deleteModel(model); }
};
struct DeleteData {
  void operator()(mjData* data) const { mj_deleteData(data); }
};
using Model = std::unique_ptr<mjModel, DeleteModel>;
using Data = std::unique_ptr<mjData, DeleteData>;

/// Compiles MJCF text. Throws `std::runtime_error` with MuJoCo's message.
inline Model make_model(const char* mjcf) {
  char error[512] = "";
  mjSpec* spec = mj_parseXMLString(mjcf, nullptr, error, sizeof(error));
  if (!spec) throw std::runtime_error(error);
  Model model(mj_compile(spec, nullptr));
  mj_deleteSpec(spec);
  if (!model) throw std::runtime_error("the model does not compile");
  return model;
}

/// A cart on a rail with a position servo, and user data for its motion.
inline constexpr const char* kCart = R"(
<mujoco>
  <size nuserdata="13"/>
  <option timestep="0.002" gravity="0 0 0"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" range="-10 10"/>
      <geom type="box" size="0.1 0.1 0.1" mass="1"/>
      <site name="front" pos="0.1 0 0"/>
    </body>
  </worldbody>
  <actuator><position joint="slide" kp="100" kv="20" ctrlrange="-10 10"/></actuator>
</mujoco>)";

/// A soft block of 1 kg that lies on a plate, with a ball beside it that nothing touches.
inline constexpr const char* kSoftBlock = R"(
<mujoco>
  <option timestep="0.002" integrator="discrete"/>
  <worldbody>
    <geom name="plate" type="box" size="0.5 0.5 0.1" pos="0 0 -0.1"/>
    <geom name="ball" type="sphere" size="0.1" pos="0.4 0 0.2"/>
    <flexcomp name="block" type="grid" count="3 3 3" spacing="0.05 0.05 0.05" pos="0 0 0.06" dim="3" mass="1"
              radius="0.005" dof="trilinear">
      <elasticity young="2e4" poisson="0.3" damping="0.002"/>
      <contact selfcollide="none"/>
    </flexcomp>
  </worldbody>
</mujoco>)";

/// Six hinges on a base that is moved and turned.
inline constexpr const char* kArm = R"(
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="base" pos="0.3 -0.2 0.1" euler="0.3 0.2 0.1">
      <geom type="sphere" size="0.02" mass="1"/>
      <body name="link1">
        <joint name="joint1" axis="0 0 1" range="-3 3"/><geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
        <body name="link2" pos="0.3 0 0">
          <joint name="joint2" axis="0 1 0" range="-2 2"/><geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
          <body name="link3" pos="0.3 0 0">
            <joint name="joint3" axis="0 1 0" range="-2 2"/><geom type="capsule" size="0.02" fromto="0 0 0 0.2 0 0"/>
            <body name="link4" pos="0.2 0 0">
              <joint name="joint4" axis="1 0 0" range="-3 3"/><geom type="sphere" size="0.02"/>
              <body name="link5">
                <joint name="joint5" axis="0 0 1" range="-2 2"/><geom type="sphere" size="0.02"/>
                <body name="link6">
                  <joint name="joint6" axis="0 1 0" range="-2 2"/><geom type="sphere" size="0.02"/>
                  <site name="tcp" pos="0.1 0 0"/>
                </body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>)";

}  // namespace rcs::test
